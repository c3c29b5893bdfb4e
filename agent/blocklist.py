"""What the process of an agent goes without. Imported first by `agent/__main__.py`, and by nothing else.

NumPy and msgspec load these where they are there, and do the same without. An agent never asks for what they add, and
twenty-five of them would each carry it: OpenSSL, of which only hashes would be used, is 3 MiB. It holds for the whole
process, so only a process that is nothing but an agent may decide it.
"""

import sys
from importlib.util import find_spec

WITHOUT = ["ctypes", "typing_extensions"]
if find_spec("_sha2") or find_spec("_sha512"):  # Python's own, from 3.12 on and before; some builds leave them out
    WITHOUT.append("_hashlib")

for _name in WITHOUT:
    sys.modules.setdefault(_name, None)  # type: ignore[arg-type]  # an import of it fails as if it were not installed
