"""Writes api.md, the reference of the Python API, from signatures and docstrings."""

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import meanflock as mf
from meanflock import env, testing

PAGE = Path(__file__).with_suffix(".md")
WIDTH = 100  # of a signature in one line

SECTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "Fly": (
        "A flight in this process; see [first flight](first-flight.md).",
        ("fly", "Stepped", "open", "Run", "Scenario"),
    ),
    "Study": (
        "Many flights on many processes, and a table of their means; see [your study](your-study.md).",
        ("compare", "sweep", "Comparison"),
    ),
    "A controller": (
        "See [your controller](your-controller.md).",
        ("Controller", "Options", "Received", "Broadcast", "Step", "Arrival"),
    ),
    "A learner": (
        "Trains a model while UAVs fly; see [train your PyTorch model](train-in-flight.md).",
        ("Learner", "Fit", "Trained", "Tree"),
    ),
    "An aggregation rule": (
        "See [your aggregation rule](your-aggregation.md).",
        ("Aggregator", "Uploads", "Aggregate"),
    ),
    "A coding": (
        "How the numbers of models are written on the radio; `examples/qsgd.py` and `examples/signsgd.py` are two. "
        "`check_coding` of `meanflock.testing` tests yours, and `meanflock new coding NAME` writes a package for it.",
        ("Coding",),
    ),
    "A channel": ("See [your channel](your-channel.md).", ("Channel", "Message")),
    "A filter": (
        "May change the accelerations of any controller; "
        "see [the filter](controllers.md#the-filters-ecbf-and-braking-before-any-controller).",
        ("Filter",),
    ),
    "A vehicle": ("See [your vehicle](your-vehicle.md).", ("Vehicle",)),
    "Installed plug-ins": ("", ("plugins", "register", "Plugin")),
    "The mission": ("Start, launch time and goal of each UAV; all UAVs know them.", ("mission",)),
    "Randomness": ("Random generators for your controller, drawn from the scenario's seed.", ("seeds",)),
    "Errors": ("", ("MeanflockError", "BadInput", "RunFailed")),
}
ALIASES = {"mf.Tree": "A dict or list of arrays, or of further dicts and lists. An array is NumPy's or torch's."}
MEMBERS = {  # classes of which only these members are shown
    "Scenario": ("load", "replace", "save", "period_ticks", "participants", "max_ticks", "sha256"),
    "Plugin": (),
}


def page() -> str:
    """The whole page."""
    lines = [
        "# The Python API",
        "",
        "`python docs/api.py` writes this page from signatures and docstrings; a test compares it with the code.",
        "Everything here is a name of `meanflock`, imported as `import meanflock as mf` and loaded when first used.",
        "Import `meanflock.env` and `meanflock.testing` separately.",
        "In shapes N is the number of UAVs, M of rows of a node, T of ticks.",
    ]
    for title, (about, names) in SECTIONS.items():
        lines += ["", f"## {title}", *(["", about] if about else [])]
        for name in names:
            lines += _entry(f"mf.{name}", getattr(mf, name), MEMBERS.get(name))
    lines += ["", "## meanflock.env", "", *_prose(inspect.getdoc(env) or "")]
    for name in ("parallel_env", "vector_env", "policy", "save_policy", "Policy"):
        lines += _entry(f"env.{name}", getattr(env, name), None)
    lines += ["", "## meanflock.testing", "", *_prose(inspect.getdoc(testing) or "")]
    for name in sorted(testing.__all__, key=lambda name: (name[0].isupper(), name)):
        lines += _entry(f"testing.{name}", getattr(testing, name), None)
    return "\n".join(lines) + "\n"


def _entry(name: str, member: Any, members: tuple[str, ...] | None) -> Iterator[str]:
    yield from ("", f"### {name}", "")
    if name in ALIASES:
        yield from ("```python", f"{name} = {member}".replace("typing.", ""), "```", "", ALIASES[name])
    elif isinstance(member, ModuleType):
        yield from _prose(inspect.getdoc(member) or "")
        for one, function in inspect.getmembers(member, inspect.isfunction):
            if function.__module__ == member.__name__ and not one.startswith("_"):
                yield from ("", *_function(f"{name}.{one}", function))
    elif inspect.isclass(member):
        yield from _class(member, members)
    else:
        yield from _function(name, member)


def _class(class_: type, members: tuple[str, ...] | None) -> Iterator[str]:
    yield from _prose(inspect.getdoc(class_) or "")
    source = textwrap.dedent(inspect.getsource(class_)).splitlines()
    body = ast.parse("\n".join(source)).body[0].body  # type: ignore[attr-defined]
    fields = [source[node.lineno - 1].strip() for node in body if isinstance(node, ast.AnnAssign)]
    fields = [field for field in fields if not field.startswith("plugin_kind:")]
    if fields and members is None:
        yield from ("", "```python", *fields, "```")
    for node in body:
        if isinstance(node, ast.FunctionDef) and _is_shown(node, members):
            yield from ("", *_method(node, f"mf.{class_.__name__}."))


def _is_shown(node: ast.FunctionDef, members: tuple[str, ...] | None) -> bool:
    if members is not None:
        return node.name in members
    return ast.get_docstring(node) is not None and (not node.name.startswith("_") or node.name == "__init__")


def _function(name: str, function: Any) -> Iterator[str]:
    node = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(node, ast.FunctionDef)
    yield from ("```python", *_signature(name, node), "```", "")
    yield from _prose(ast.get_docstring(node) or "")


def _method(node: ast.FunctionDef, class_name: str) -> Iterator[str]:
    is_of_class = any(ast.unparse(decorator) == "classmethod" for decorator in node.decorator_list)
    if any(isinstance(one, ast.Name | ast.Attribute) and "property" in ast.unparse(one) for one in node.decorator_list):
        yield from ("```python", f"{node.name}: {ast.unparse(node.returns) if node.returns else 'Any'}", "```", "")
    else:
        node.args.args = node.args.args[1:]  # without self
        name = class_name + node.name if is_of_class else node.name
        yield from ("```python", *_signature(name, node), "```", "")
    yield from _prose(ast.get_docstring(node) or "")


def _signature(name: str, node: ast.FunctionDef) -> list[str]:
    returns = f" -> {ast.unparse(node.returns)}" if node.returns is not None and node.name != "__init__" else ""
    parts = re.split(r", (?=[*\w]+(?::|=|,|$)|\*,)", ast.unparse(node.args))
    parts = [re.sub(r"^(\w+: .+?)=", r"\1 = ", part) for part in parts]
    line = f"{name}({', '.join(parts)}){returns}"
    if len(line) <= WIDTH:
        return [line]
    return [f"{name}(", *(f"    {part}," for part in parts), f"){returns}"]


def _prose(docstring: str) -> list[str]:
    """A docstring as Markdown: its sections in bold, its indented parts as code."""
    lines: list[str] = []
    for part in docstring.split("\n\n"):
        head, _, rest = part.partition("\n")
        if head in ("Args:", "Attributes:", "Returns:", "Raises:", "Yields:"):
            lines += [f"*{head[:-1]}*:", "", *_items(rest, least=1), ""]
        elif all(line.startswith("    ") for line in part.splitlines()):
            again = lines[-2:] == ["```", ""]  # blank lines of one piece of code
            lines = [*lines[:-2], "", ""] if again else [*lines, "```python"]
            lines += [*textwrap.dedent(part).splitlines(), "```", ""]
        else:
            lines += [*_items(part), ""]
    return lines[:-1]


def _items(text: str, least: int = 2) -> list[str]:
    """A list where a text goes by `name: meaning. name: meaning.`, with so many at least; else a paragraph."""
    text = " ".join(text.split())
    starts = [match.start(1) for match in re.finditer(r"(?:^|(?<=[.?]\s))(?!None)(\w+(?:, \w+)*): ", text)]
    if len(starts) < least or starts[0]:
        return [text]
    parts = [text[one:other].strip() for one, other in itertools.pairwise([*starts, len(text)])]
    named = (part.partition(": ") for part in parts)
    return [f"- `{names.replace(', ', '`, `')}`: {about}" for names, _, about in named]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
