"""What mkdocs does not do: pages from outside docs/, executed notebooks, equations as MathML.

The README is the first page. Where a compiler is there, it leads to a hand to pull at. A
file of the repository that a page links to becomes a page below source/. A link to a file that is
not there stays as it is, and `mkdocs build --strict` then fails.
"""

from __future__ import annotations

import html
import posixpath
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from notebooks import executed

from benchmarks.runtimes.c_programs import BROWSER, for_a_browser

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
LINK = re.compile(r"(\]\()(?!\w+:)([^)#\s]+)(?=[)#])")
FENCE = re.compile(r"(^ *```.*?^ *```[^\n]*$)", re.DOTALL | re.MULTILINE)
UNNAMED = re.compile(r"\A( *```)\n")
LIST_AFTER_TEXT = re.compile(
    r"^((?![-*|#>\s]|\d+\. ).+\n)(?=(?:- |\d+\. ))", re.MULTILINE
)
LIST_AFTER_PARAGRAPH = re.compile(r"(\n\n(?: +\S.*\n)+)(?=- )")
INDENT = re.compile(r"^ {2,3}(?=\S)", re.MULTILINE)
EQUATION = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)
FIRST_SIGHT = re.compile(r'<img [^>]*src="([^"]*first-sight)\.svg"[^>]*>')
PARAGRAPH = re.compile(r"<p>(.*?)</p>", re.DOTALL)
PARAMETER = re.compile(
    r"(?:^|(?<=[.;)] )|(?<=\.\n))([a-z]\w*(?: \[[^\]]*\])?(?:, [a-z]\w*(?: \[[^\]]*\])?)*): "
)
PHONE = "(max-width: 44.984375em)"
MODEL = ROOT / "models/holdfast-150hz.onnx"
TRY = """
[**Try it here**: pull a bottle out of a hand, and see the call and the grip](try.html){ .try }
"""
TRY_HERE = """
<iframe class="try" src="try.html" title="A simulated hand to pull at" loading="lazy">
</iframe>
"""
IN_NAV = ("CHANGELOG.md", "CONTRIBUTING.md")
SHIM, FROM_ELSEWHERE = "iframe-worker.js", "https://unpkg.com/iframe-worker/shim"
LOADED = re.compile(r'(?:src|<link[^>]*href)="(https?://[^"]*)"')
LANGUAGES = {
    ".py": "python",
    ".toml": "toml",
    ".c": "c",
    ".h": "c",
    ".js": "js",
    ".rs": "rust",
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README, the notebooks, the style sheet, and every source that a page leads to."""
    _add(files, config, "index.md", (ROOT / "README.md").read_text("utf-8"))
    for name in ("holdfast.css", SHIM):
        _add(files, config, name, (HERE / name).read_text("utf-8"))
    for name, content in _pages_to_try().items():
        _add(files, config, name, content)
    for source in sorted((ROOT / "docs/notebooks").glob("*.py")):
        for name, content in executed(source).items():
            _add(files, config, f"notebooks/{name}", content)
    waiting = [file for file in files if file.src_uri.endswith(".md")]
    waiting += [
        _add(files, config, f"source/{path}", _as_page(path)) for path in IN_NAV
    ]
    while waiting:
        file = waiting.pop()
        for path in sorted(_sources(file)):
            if files.get_file_from_path(f"source/{_page_name(path)}") is None:
                waiting.append(
                    _add(files, config, f"source/{_page_name(path)}", _as_page(path))
                )
    return files


def on_page_markdown(markdown: str, page: Page, files: Files, **_: Any) -> str:
    """Links in the site's own terms; lists and fences as GitHub reads them."""
    if page.file.src_uri == "index.md" and files.get_file_from_path("try.html"):
        # Before the first picture.
        markdown = markdown.replace("\n![", f"{TRY}\n![", 1)
        markdown = markdown.replace("## Try it\n", f"## Try it\n{TRY_HERE}\n", 1)
    parts = FENCE.split(markdown)
    for place in range(0, len(parts), 2):
        linked = LINK.sub(
            lambda m: m[1] + _target(page.file.src_uri, m[2]), parts[place]
        )
        indented = INDENT.sub("    ", LIST_AFTER_PARAGRAPH.sub(r"\1\n", linked))
        parts[place] = LIST_AFTER_TEXT.sub(r"\1\n", indented)
    for place in range(1, len(parts), 2):
        # commands that need hardware or a person stand in blocks without a name
        parts[place] = UNNAMED.sub(r"\1sh\n", parts[place])
    return "".join(parts)


def on_page_content(content: str, page: Page, **_: Any) -> str:
    """Equations as MathML, without a script; parameters as lists; a first picture for phones."""
    content = EQUATION.sub(_mathml, content)
    for_phone = (
        rf'<picture><source media="{PHONE}" srcset="\1-phone.svg">\g<0></picture>'
    )
    content = FIRST_SIGHT.sub(for_phone, content)
    if page.file.src_uri == "api.md":
        content = PARAGRAPH.sub(_listed, content)
    return content


def on_post_page(output: str, page: Page, **_: Any) -> str:
    """The search's helper from the site itself. Raises PluginError where a page loads from afar."""
    own = posixpath.relpath(SHIM, posixpath.dirname(page.url) or ".")
    return _require_own(output.replace(FROM_ELSEWHERE, own), page.url)


def on_post_template(output_content: str, template_name: str, **_: Any) -> str:
    """The same for the page of a wrong address; its links work in a folder, too."""
    own = output_content.replace(FROM_ELSEWHERE, SHIM)
    if template_name == "404.html":
        own = re.sub(r'((?:href|src)=")/(?!/)', r"\1", own)
        # the way home of a site without an address
        own = own.replace('href=""', 'href="index.html"').replace(
            'href="."', 'href="index.html"'
        )
    return _require_own(own, template_name)


def _require_own(output: str, name: str) -> str:
    loaded = LOADED.findall(output)
    if loaded and name.endswith(".html"):
        raise PluginError(f"{name} loads {', '.join(loaded)}")
    return output


def _listed(match: re.Match[str]) -> str:
    """A paragraph `one: .. two: ..` of a docstring as a list, a parameter a line."""
    starts = list(PARAMETER.finditer(match[1]))
    if not starts or (len(starts) == 1 and starts[0].start() > 0):
        return match[0]
    text = match[1]
    head = text[: starts[0].start()].strip()
    ends = [one.start() for one in starts[1:]] + [len(text)]
    items = [
        f"<li><strong>{one[1]}</strong>: {text[one.end() : end].strip()}</li>"
        for one, end in zip(starts, ends, strict=True)
    ]
    before = f"<p>{head}</p>" if head else ""
    return f"{before}<ul>{''.join(items)}</ul>"


def _mathml(match: re.Match[str]) -> str:
    display = "block" if match[1] == "div" else "inline"
    mathml = convert(html.unescape(match[2]).strip(), display=display)
    return (
        f'<div class="wide" tabindex="0">{mathml}</div>'
        if match[1] == "div"
        else mathml
    )


def _pages_to_try() -> dict[str, str]:
    """The pages of examples/browser; none without a compiler."""
    compiler = for_a_browser()
    if not all(map(shutil.which, (compiler.compiler, *compiler.also))):
        return {}
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, BROWSER / "build.py", MODEL, folder, "index.html"]
        subprocess.run([str(word) for word in words], check=True)
        made = sorted(Path(folder).glob("*.html"))
        return {page.name: page.read_text("utf-8") for page in made}


def _add(files: Files, config: MkDocsConfig, uri: str, content: str) -> File:
    file = File.generated(config, uri, content=content)
    files.append(file)
    return file


def _repository_path(uri: str) -> str:
    """Where a page stands in the repository."""
    if uri.startswith("source/"):
        return uri.removeprefix("source/")
    return "README.md" if uri == "index.md" else f"docs/{uri}"


def _linked_path(uri: str, link: str) -> str:
    return posixpath.normpath(
        posixpath.join(posixpath.dirname(_repository_path(uri)), link)
    )


def _page_name(path: str) -> str:
    return path if path.endswith(".md") else f"{path}.md"


def _sources(file: File) -> set[str]:
    """Repository paths outside docs/ that a page links to."""
    text = "".join(FENCE.split(file.content_string)[::2])
    paths = {_linked_path(file.src_uri, match[2]) for match in LINK.finditer(text)}
    return {
        path
        for path in paths
        if path != "README.md"
        and not path.startswith("docs/")
        and (ROOT / path).exists()
    }


def _target(uri: str, link: str) -> str:
    """A link of a page as a link of the site."""
    path = _linked_path(uri, link)
    if path == "README.md":
        target = "index.md"
    elif path.startswith("docs/"):
        target = path.removeprefix("docs/")
        if target.startswith("notebooks/"):
            target = target.replace(".py", ".md")
    elif (ROOT / path).exists():
        target = f"source/{_page_name(path)}"
    else:
        return link
    return posixpath.relpath(target, posixpath.dirname(uri) or ".")


def _as_page(path: str) -> str:
    """A file or a folder of the repository as a page that the search leaves out."""
    if (ROOT / path).is_dir():
        names = sorted(one.name for one in (ROOT / path).iterdir() if one.is_file())
        links = "".join(
            f"- [{name}]({posixpath.basename(path)}/{name})\n" for name in names
        )
        return f"# {path}\n\n{links}"
    text = (ROOT / path).read_text("utf-8")
    head = "---\nsearch:\n  exclude: true\n---\n"
    if path.endswith(".md"):
        return head + text
    language = LANGUAGES.get(Path(path).suffix, "text")
    return f"{head}# {path}\n\n````{language}\n{text.rstrip()}\n````\n"
