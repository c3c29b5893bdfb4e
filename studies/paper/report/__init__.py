"""The report of the paper's experiments: every claim with its verdict, as Markdown and HTML."""
