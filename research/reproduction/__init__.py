"""The reproduction of the paper: its experiments, its claims and the verdicts on them.

It is a folder of the source and no part of the wheel. It imports `meanflock` as any user does.
`meanflock paper` runs it.
"""
