"""Architecture rules that a program can check: allowed imports."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent.name for path in (ROOT / "src").glob("plate_*/setup.py"))
"""Those with code; plate_interfaces, the messages and actions, counts as ROS."""
SHARED = "plate_core"
"""The one package that others may import."""
COMPOSED = {"plate_bringup", "plate_drives", "plate_gym"}
"""The packages that put stages together."""

AVERAGES = "plate_solver.averages"
"""Modules that compute mean forces, separate from steering."""

ROS = re.compile(r"rclpy|\w+_msgs|\w+_interfaces|std_srvs|rosidl\w*|rpyutils|ament_\w+|launch\w*")
# Imports that a core may use besides the standard library, and the rosdep key that declares each.
LIBRARIES = {
    "can": "python3-can",
    "cv2": "python3-opencv",
    "matplotlib": "python3-matplotlib",
    "numpy": "python3-numpy",
    "scipy": "python3-scipy",
    "serial": "python3-serial",
    "setuptools": "python3-setuptools",
    "shapely": "python3-shapely",
    "tornado": "python3-tornado",
    "yaml": "python3-yaml",
}
BY_PIP = {"distributed", "gymnasium", "harvesters"}
"""What pip alone installs, as package.xml says in a comment: by rosdep's key pip would change the
system's Python, which refuses."""
TESTED_WITH = {"hypothesis": "python3-hypothesis", "pytest": "python3-pytest"}


def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def files(*patterns: str) -> list[Path]:
    found = sorted(path for pattern in patterns for path in ROOT.glob(pattern))
    assert found, patterns
    made = {"__pycache__", "build"}  # by Python and by pip
    return [path for path in found if not made & set(path.relative_to(ROOT).parts)]


def sources(package: str) -> list[Path]:
    return files(f"src/{package}/{package}/**/*.py")


def label(path: Path) -> str:
    return str(path.relative_to(ROOT))


@cache
def imports(path: Path) -> frozenset[str]:
    """Full names of all that a file imports, also inside functions: modules, and names in them."""
    module = path.relative_to(ROOT / "src").parts[1:-1] if path.is_relative_to(ROOT / "src") else ()
    names: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = module[: len(module) - node.level + 1] if node.level else ()
            stem = ".".join((*base, *([node.module] if node.module else [])))
            names.update(f"{stem}.{alias.name}" for alias in node.names)
    return frozenset(names)


def roots(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(path)}


def may_use_ros(path: Path) -> bool:
    inside = path.relative_to(ROOT / "src").parts
    return (
        path.name == "node.py"
        or inside[2:3] == ("ros",)
        or (inside[0] == "plate_bringup" and path.name in ("actions.py", "one_process.py"))
    )


def is_ros(name: str) -> bool:
    return bool(ROS.fullmatch(name.split(".")[0])) or name.split(".")[:2] == ["plate_core", "ros"]


def declared(package: str, kinds: str) -> set[str]:
    text = (ROOT / "src" / package / "package.xml").read_text(encoding="utf-8")
    return set(re.findall(rf"<(?:{kinds})?depend>([^<]+)</", text))


def undeclared(package: str, paths: list[Path], kinds: str, known: dict[str, str]) -> set[str]:
    """Imports that package.xml does not declare."""
    found = {root for path in paths for root in roots(path)}
    needed = {known.get(n, n) for n in found if n in {*known, *PACKAGES} or ROS.fullmatch(n)}
    return needed - declared(package, kinds) - {package}


@cache
def public(module: str) -> set[str] | None:
    """The names in `__all__` of a package or of one of its chapters; None: it has no such list."""
    package, *chapter = module.split(".")
    place = ROOT / "src" / package / package / Path(*chapter)
    path = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    if len(chapter) > 1 or not path.exists():
        return None
    for node in tree(path).body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return set(ast.literal_eval(node.value))
    return None


def is_public(name: str) -> bool:
    """Whether others may import this name; nodes are there to be made by others."""
    stem, _, last = name.rpartition(".")
    return (
        name in PACKAGES
        or name.endswith(".node")
        or stem.endswith(".node")
        or public(name) is not None
        or last in (public(stem) or ())
    )


def test_only_nodes_import_ros():
    offenders = [
        f"{label(path)}: {name}"
        for package in PACKAGES
        for path in sources(package)
        if not may_use_ros(path)
        for name in sorted(filter(is_ros, imports(path)))
    ]
    assert not offenders, (
        "ROS is for node.py, folders ros/ and what launch files start:\n" + "\n".join(offenders)
    )


def test_nodes_of_driver_and_planner_only_connect():
    """Topics, services, timers and parameters with objects that need no ROS. These compute."""
    offenders = [
        f"{label(path)}: numpy"
        for package in ("plate_driver", "plate_planner")
        for path in sources(package)
        if may_use_ros(path) and "numpy" in roots(path)
    ]
    assert not offenders, "\n".join(offenders)


def test_stages_import_no_other_stage():
    offenders = [
        f"{label(path)}: {root}"
        for package in PACKAGES
        if package not in COMPOSED
        for path in sources(package)
        for root in sorted(roots(path) & set(PACKAGES) - {package, SHARED})
    ]
    assert not offenders, f"packages import only {SHARED}:\n" + "\n".join(offenders)


def test_the_running_loop_does_not_import_the_averages():
    """Only agents of the gym use them, and code outside `src`; no kernel includes one of theirs."""
    own = {AVERAGES, *(f"plate_solver.{name}" for name in public(AVERAGES) or ())}
    door = ROOT / "src/plate_solver/plate_solver/__init__.py"
    chapter = door.parent / "averages"
    paths = [path for package in PACKAGES if package != "plate_gym" for path in sources(package)]
    offenders = [
        f"{label(path)}: {name}"
        for path in paths
        if path != door and not path.is_relative_to(chapter)
        for name in sorted(imports(path))
        if name in own or name.startswith(f"{AVERAGES}.")
    ]
    offenders += [
        f"{label(path)}: averages/"
        for path in files("src/plate_solver/plate_solver/**/*.[ch]pp")
        if not path.is_relative_to(chapter)
        if '#include "averages/' in path.read_text(encoding="utf-8")
    ]
    assert not offenders, "\n".join(offenders)
    code = f"import sys, plate_bringup.loop; assert {AVERAGES!r} not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_only_one_module_of_the_solver_reads_requests():
    """Behind `goal/conversion.py` there are goals: no other file distinguishes forces and
    targets."""
    kinds = {f"plate_core.{name}" for name in ("AngleTargets", "Forces", "Targets")}
    readers = {path.name for path in sources("plate_solver") if kinds & imports(path)}
    assert readers == {"conversion.py"}


def test_only_known_libraries_and_package_xml_names_them():
    """Or `colcon test`, which knows of nothing else, cannot run a package's tests."""
    known = {*sys.stdlib_module_names, *LIBRARIES, *BY_PIP, *PACKAGES}
    offenders = []
    for package in PACKAGES:
        code, tests = sources(package), files(f"src/{package}/test/*.py")
        for path in code:
            strange = {root for root in roots(path) - known if not ROS.fullmatch(root)}
            offenders += [f"{label(path)}: {root} is not known" for root in sorted(strange)]
        for name in sorted(undeclared(package, code, "exec_", LIBRARIES)):
            offenders.append(f"src/{package}/package.xml: exec_depend of {name} is missing")
        for name in sorted(undeclared(package, tests, "exec_|test_", LIBRARIES | TESTED_WITH)):
            offenders.append(f"src/{package}/package.xml: test_depend of {name} is missing")
    assert not offenders, f"known: {sorted(LIBRARIES)}\n" + "\n".join(offenders)


def test_package_xml_lists_in_a_comment_what_only_pip_installs():
    for package in PACKAGES:
        needed = {root for path in sources(package) for root in roots(path)} & BY_PIP
        text = (ROOT / "src" / package / "package.xml").read_text(encoding="utf-8")
        comments = " ".join(re.findall(r"<!--(.*?)-->", text, re.DOTALL))
        assert not [name for name in needed if f"pip install {name}" not in comments], package


def test_rosdep_knows_all_that_package_xml_names():
    """Each key is in the list of keys that were found in the public index, and each of these is
    needed."""
    lines = (ROOT / "test/rosdep_keys.txt").read_text(encoding="utf-8").splitlines()
    known = {line for line in lines if line and not line.startswith("#")}
    packages = {path.parent.name for path in files("src/*/package.xml")}
    named = {key for package in packages for key in declared(package, r"\w+_")}
    assert named - packages == known


def test_packages_import_only_public_names_of_others():
    """The public names are those in `__all__` of a package or of one of its chapters."""
    offenders = [
        f"{label(path)}: {name}"
        for path in files(
            "src/**/*.py", "bench/**/*.py", "tools/**/*.py", "test/*.py", "examples/**/*.py"
        )
        for name in sorted(imports(path))
        if name.split(".")[0] in PACKAGES
        and not path.is_relative_to(ROOT / "src" / name.split(".")[0])
        and not is_public(name)
    ]
    assert not offenders, "not in `__all__`:\n" + "\n".join(offenders)


def test_modules_have_no_circular_imports():
    """Imports for annotations count too: a reader follows them like all others."""
    paths = [path for package in PACKAGES for path in sources(package)]
    modules = {}
    for path in paths:
        parts = path.relative_to(ROOT / "src").with_suffix("").parts[1:]
        modules[".".join(parts[: -1 if path.stem == "__init__" else None])] = path
    graph = {}
    for name, path in modules.items():
        longest = (
            ".".join(words[:n])
            for words in (each.split(".") for each in imports(path))
            for n in range(len(words), 0, -1)
            if ".".join(words[:n]) in modules
        )
        graph[name] = {each for each in longest if not name.startswith(f"{each}.")} - {name}
    order = list(TopologicalSorter(graph).static_order())  # or a CycleError that names the circle
    assert order.index("plate_core.rig.sections") < order.index("plate_core.rig.rig")


def test_guards_do_not_trust_the_timeline():
    """Code that stops the motors must not depend on the rule by which others predict cycles."""
    rule = {"Timeline", "in_time", "next_cycle", "timeline"}
    offenders = [
        f"{label(path)}: {name}"
        for path in sources("plate_driver")
        for name in sorted(imports(path))
        if name.startswith("plate_core.motion.") and rule & set(name.split("."))
    ]
    assert not offenders, "\n".join(offenders)
