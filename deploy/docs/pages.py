"""Hooks of the documentation's build: pages from outside docs/, the reference of the code, no code inside pages.

The page server allows no inline script and no inline style (`rigctl.page.guard`), so that nothing that finds its way
into a page can act as the operator. The theme writes some of both; each is moved into a file of its own.
"""

from __future__ import annotations

import ast
import hashlib
import pathlib
import re

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = pathlib.Path(__file__).parents[2]
AT_THE_ROOT = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "LICENSE": "license.md",
}
REFERENCE = {
    "rigctl.client": "Client",
    "rigctl.recorder": "Recordings",
    "rigctl.metrics": "Figures",
    "rigctl.config": "Rig files",
    "rigctl.control": "Control",
    "rigctl.design": "Design",
    "rigctl.commission": "Commissioning",
    "rigctl.wire": "Messages",
    "hil": "Simulated rig",
    "hil.scenario": "Scenarios",
    "hil.faults": "Faults",
}
"""Packages of the reference: those that a user's own code imports, and what they are made of."""
INLINE = "assets/inline"
PRINT = "assets/print.css"
NOT_NEEDED = ("**/*.map", "assets/javascripts/lunr/**/*", "sitemap.xml*", "objects.inv")
_LINK = re.compile(r"(\]\()(?!https?:)([^)#\s]*)((?:#[^)]*)?\))")
_MERMAID = re.compile(r"^```mermaid\n(.*?)^```\n", re.MULTILINE | re.DOTALL)
_ARROW = re.compile(r"^\s*(\w+) --> (\w+): (.+)$", re.MULTILINE)
_SCRIPT = re.compile(r"<script>(.*?)</script>", re.DOTALL)
_STYLE = re.compile(r"<style>(.*?)</style>", re.DOTALL)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the reference to the navigation."""
    packages = [{title: _page_of(package)} for package, title in REFERENCE.items()]
    assert config.nav is not None
    config.nav.append({"Reference": packages})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/."""
    for source, target in AT_THE_ROOT.items():
        text = (ROOT / source).read_text()
        content = text if source.endswith(".md") else f"# License\n\n```text\n{text}```\n"
        files.append(File.generated(config, target, content=content))
    files.append(File.generated(config, PRINT, content=(ROOT / "deploy/docs/print.css").read_text()))
    for package, title in REFERENCE.items():
        files.append(File.generated(config, _page_of(package), content=_reference(package, title)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Point links at the site's own pages, and write a state diagram as a table (the theme draws it with a CDN)."""
    return _MERMAID.sub(_as_table, _LINK.sub(_within_site, markdown))


def on_post_page(output: str, page: Page, config: MkDocsConfig) -> str:
    """Move the page's scripts and styles into files."""
    return _without_inline(output, page.url, pathlib.Path(config.site_dir))


def on_post_template(output_content: str, template_name: str, config: MkDocsConfig) -> str:
    """Move those of the page "not found"."""
    return _without_inline(output_content, template_name, pathlib.Path(config.site_dir))


def on_post_build(config: MkDocsConfig) -> None:
    """Delete what no page asks for."""
    site = pathlib.Path(config.site_dir)
    for pattern in NOT_NEEDED:
        for file in site.glob(pattern):
            if file.is_file():
                file.unlink()


def _page_of(package: str) -> str:
    return f"reference/{package}.md"


def _reference(package: str, title: str) -> str:
    """A page with every public module of a package; those that hold nothing public but a constant are left out."""
    folder = ROOT.joinpath(*package.split("."))
    lines = [f"# {title}: {package}", ""]
    for file in sorted(folder.glob("*.py") if package == "hil" else folder.rglob("*.py")):
        tree = ast.parse(file.read_text())
        defined = [node.name for node in tree.body if isinstance(node, ast.ClassDef | ast.FunctionDef)]
        if file.stem.startswith("__") or not any(not name.startswith("_") for name in defined):
            continue
        within = ".".join(file.relative_to(folder).with_suffix("").parts)
        lines += [f"::: {package}.{within}", ""]
    return "\n".join(lines)


def _within_site(link: re.Match[str]) -> str:
    before, target, after = link.groups()
    if target in AT_THE_ROOT or target.removeprefix("../") in AT_THE_ROOT:
        target = AT_THE_ROOT[target.removeprefix("../")]
    return before + target.removeprefix("docs/") + after


def _as_table(diagram: re.Match[str]) -> str:
    rows = [f"| {before} | {after} | {' '.join(why.split())} |" for before, after, why in _ARROW.findall(diagram[1])]
    return "\n".join(["| from | to | when |", "|---|---|---|", *rows, ""])


def _without_inline(html: str, url: str, site: pathlib.Path) -> str:
    up = "../" * url.count("/")

    def script(found: re.Match[str]) -> str:
        return f'<script src="{up}{_kept(found[1], "js", site)}"></script>'

    def style(found: re.Match[str]) -> str:
        return f'<link rel="stylesheet" href="{up}{_kept(found[1], "css", site)}">'

    return _STYLE.sub(style, _SCRIPT.sub(script, html))


def _kept(text: str, kind: str, site: pathlib.Path) -> str:
    name = f"{INLINE}/{hashlib.sha256(text.encode()).hexdigest()[:12]}.{kind}"
    file = site / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return name
