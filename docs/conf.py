"""The site of `make docs`: the Markdown pages of the repository, and the API from docstrings."""

import importlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
API = ROOT / "docs/api"

project = "Vibrating plate"
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
root_doc = "docs/index"
include_patterns = [
    "*.md",
    "docs/*.md",
    "docs/guide/*.md",
    "docs/api/*.rst",
    "firmware/README.md",
    "firmware/drives/README.md",
    "firmware/boards/*/README.md",
]
exclude_patterns = [".*", "build", "install", "log", "out"]
html_theme = "furo"
html_title = project
html_copy_source = False

myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings contain the types, with shapes and units
numpydoc_show_class_members = False  # autodoc does


def write_api() -> None:
    """Write an API page for each package. The page lists the names in `__all__` of each subpackage,
    and the further names in `__all__` of the package itself."""
    API.mkdir(exist_ok=True)
    for package in sorted((ROOT / "src").glob("plate_*/plate_*")):
        lines, shown = [title(package.name, "=")], set()
        chapters = [
            f"{package.name}.{p.parent.name}" for p in sorted(package.glob("*/__init__.py"))
        ]
        for name in (*chapters, package.name):
            module = importlib.import_module(name)
            public = {word: id(getattr(module, word)) for word in getattr(module, "__all__", ())}
            again = ", ".join(word for word, it in public.items() if it in shown)
            shown |= set(public.values())
            lines.append(title(name, "-"))
            lines.append(f".. automodule:: {name}\n   :members:\n   :exclude-members: {again}\n")
        (API / f"{package.name}.rst").write_text("\n".join(lines), "utf-8")


def title(name: str, line: str) -> str:
    return f"{name}\n{line * len(name)}\n"


write_api()
