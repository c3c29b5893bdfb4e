"""What the process of an agent goes without. Imported first by `agent/__main__.py`, and by nothing else.

NumPy and msgspec load these where they are there, and do the same without. An agent never asks for what they add, and
twenty-five of them would each carry it: OpenSSL's hashes alone are 3 MiB. It holds for the whole process, so only the
process that is nothing but an agent may decide it.
"""

import random  # noqa: F401  # before: on a Python that has no hashes but OpenSSL's it loads them, and they stay
import sys

WITHOUT = ("_hashlib", "ctypes", "typing_extensions")

for _name in WITHOUT:
    sys.modules.setdefault(_name, None)  # type: ignore[arg-type]  # an import of it fails as if it were not installed
