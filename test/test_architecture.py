"""The rules of the house that a machine can check: who may import what."""

import ast
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.name for path in (ROOT / "src").iterdir() if path.name.startswith("plate_"))
STAGES = [name for name in PACKAGES if name != "plate_core"]
FILES = [
    path
    for name in PACKAGES
    for path in sorted((ROOT / "src" / name / name).rglob("*.py"))
    if "__pycache__" not in path.parts
]
ROS = re.compile(r"rclpy|\w+_msgs|\w+_interfaces|std_srvs|rosidl\w*|rpyutils|ament_\w+|launch\w*")
# What a core may import besides the standard library, and the rosdep key that declares it.
LIBRARIES = {
    "cv2": "python3-opencv",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "yaml": "python3-yaml",
}
TESTED_WITH = {"hypothesis": "python3-hypothesis", "pytest": "python3-pytest"}


def label(path: Path) -> str:
    return str(path.relative_to(ROOT / "src"))


def package(path: Path) -> str:
    return path.relative_to(ROOT / "src").parts[0]


def imports(path: Path) -> set[str]:
    """Full names of all modules that a file imports, also those inside functions."""
    parents = path.relative_to(ROOT / "src" / package(path)).parent.parts
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module or "")
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = parents[: len(parents) - node.level + 1]
            stem = ".".join((*base, *([node.module] if node.module else [])))
            names.add(stem)
            names.update(f"{stem}.{alias.name}" for alias in node.names)
    return names


def may_use_ros(path: Path) -> bool:
    inside = path.relative_to(ROOT / "src" / package(path) / package(path))
    return inside.name == "node.py" or (package(path) == "plate_core" and inside.parts[0] == "ros")


def declared(name: str, kinds: str = "exec_") -> set[str]:
    text = (ROOT / "src" / name / "package.xml").read_text(encoding="utf-8")
    return set(re.findall(rf"<(?:{kinds})?depend>([^<]+)</", text))


def test_there_is_something_to_check():
    assert STAGES
    assert len(FILES) > len(PACKAGES)


@pytest.mark.parametrize("path", FILES, ids=label)
def test_only_nodes_import_ros(path):
    if may_use_ros(path):
        return
    ros = {n for n in imports(path) if ROS.fullmatch(n.split(".")[0])}
    ros |= {n for n in imports(path) if n.split(".")[:2] == ["plate_core", "ros"]}
    assert not ros, f"{label(path)} imports {sorted(ros)}, allowed only in node.py"


@pytest.mark.parametrize("path", FILES, ids=label)
def test_stages_do_not_import_stages(path):
    roots = {n.split(".")[0] for n in imports(path)}
    others = (roots & set(PACKAGES)) - {package(path), "plate_core"}
    assert not others, f"{label(path)} imports {sorted(others)}, allowed: plate_core"


@pytest.mark.parametrize("path", FILES, ids=label)
def test_only_known_libraries(path):
    roots = {n.split(".")[0] for n in imports(path)}
    allowed = set(sys.stdlib_module_names) | set(LIBRARIES) | set(PACKAGES)
    unknown = {n for n in roots - allowed if not ROS.fullmatch(n)}
    assert not unknown, f"{label(path)} imports {sorted(unknown)}, allowed: {sorted(LIBRARIES)}"


@pytest.mark.parametrize("name", PACKAGES)
def test_package_declares_what_it_imports(name):
    roots = {n.split(".")[0] for p in FILES if package(p) == name for n in imports(p)}
    needed = {LIBRARIES[root] for root in roots if root in LIBRARIES}
    needed |= {root for root in roots if ROS.fullmatch(root) or root == "plate_core"}
    missing = needed - declared(name) - {name}
    assert not missing, f"package.xml of {name} lacks exec_depend of {sorted(missing)}"


@pytest.mark.parametrize("name", PACKAGES)
def test_package_declares_what_its_tests_import(name):
    """Or `colcon test`, which knows of nothing else, cannot run them."""
    files = sorted((ROOT / "src" / name / "test").glob("*.py"))
    roots = {n.split(".")[0] for path in files for n in imports(path)}
    known = LIBRARIES | TESTED_WITH
    needed = {known.get(root, root) for root in roots if root in {*known, *PACKAGES}}
    needed |= {root for root in roots if ROS.fullmatch(root)}
    missing = needed - declared(name, "exec_|test_") - {name}
    assert files
    assert not missing, f"package.xml of {name} lacks test_depend of {sorted(missing)}"
