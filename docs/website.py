"""Builds the documentation as a web site in `site/`, and checks what it built: `make docs`.

The pages are copied to `build/website` as they lie in the repository, with the files that they link to, and
rendered there. A link that works in the repository works in the site. Needs zensical, and nothing of meanflock.
"""

import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).resolve().parents[1]
SITE = ROOT / "site"
_THEME = ROOT / "docs" / "theme"
_LOADS = {
    "script": "src",
    "img": "src",
    "iframe": "src",
    "source": "src",
    "video": "src",
    "audio": "src",
    "link": "href",
}
_FETCHED = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "dns-prefetch", "modulepreload", "manifest"}


def pages() -> list[Path]:
    """The pages of the site, by their paths in the repository."""
    front = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
    return [*front, *sorted((ROOT / "docs").glob("*.md"))]


def linked(page: Path) -> set[Path]:
    """Files that a page links to or shows."""
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8"))
    files = {(page.parent / target).resolve() for target in targets if "://" not in target}
    return {file for file in files if file.is_file()}


def copy_pages(build: Path) -> None:
    """Copy the pages, and what they link to, as they lie in the repository."""
    shutil.rmtree(build, ignore_errors=True)
    files = {*pages(), *_THEME.glob("*.css"), *_THEME.glob("*.js")}.union(*map(linked, pages()))
    for file in files:
        copy = build / "docs" / file.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, copy)
    shutil.copyfile(_THEME / "zensical.toml", build / "zensical.toml")


class Page(HTMLParser):
    """Links, anchors and loaded files of an HTML page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = {""}
        self._style = False
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attributes}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        self.loads += outside_of_css(values.get("style", ""))
        self._style = tag == "style"
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        elif values.get(_LOADS.get(tag, "")) and (tag != "link" or _FETCHED & set(values.get("rel", "").split())):
            self.loads.append(values[_LOADS[tag]])

    def handle_data(self, data: str) -> None:
        if self._style:
            self.loads += outside_of_css(data)
            self._style = False


def outside_of_css(text: str) -> list[str]:
    """Addresses on other hosts that a style sheet loads."""
    found = re.findall(r"(?:url\(|@import)\s*[\"']?([^\"')\s;]+)", text)
    return [address for address in found if re.match(r"(https?:)?//", address)]


def problems(site: Path) -> list[str]:
    """Links and anchors that lead nowhere, files that are missing, and files that are loaded from elsewhere."""
    found = []
    read = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    read.pop(site / "404.html", None)  # its addresses depend on where the site is served
    for path, page in read.items():
        name = path.relative_to(site)
        for address in [*page.loads, *page.links]:
            parts = urlsplit(address)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                if address in page.loads:
                    found.append(f"{name}: loads {address} from elsewhere")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            if not target.is_file():
                found.append(f"{name}: {address}: no such file")
            elif target in read and unquote(parts.fragment) not in read[target].anchors:
                found.append(f"{name}: {address}: no such anchor")
    for path in sorted(site.rglob("*.css")):
        addresses = outside_of_css(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(site)}: loads {address} from elsewhere" for address in addresses]
    for page_ in pages():
        html = site / page_.relative_to(ROOT).with_suffix(".html")
        if not (site / "index.html" if page_.name == "README.md" else html).is_file():
            found.append(f"{page_.name}: not in the site")
    return found


def main() -> int:
    """Build and check the site; the exit code."""
    build = ROOT / "build" / "website"
    copy_pages(build)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "-f", str(build / "zensical.toml")]
    if code := subprocess.run(command, cwd=build).returncode:
        return code
    shutil.rmtree(SITE, ignore_errors=True)
    shutil.move(build / "site", SITE)  # zensical writes below its own folder only
    found = problems(SITE)
    print(*found, sep="\n", file=sys.stderr, end="\n" if found else "")
    if not found:
        print("every link leads somewhere, and nothing is loaded from elsewhere: site/index.html")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
