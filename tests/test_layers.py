"""Which module may import which, and which calls are forbidden, read from the syntax of every module."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
import tomllib
from collections.abc import Collection, Iterator, Mapping
from importlib import metadata
from pathlib import Path

import pytest

from cellapp.interfaces.tui.screens import SCREENS

ROOT = Path(__file__).parents[1]
MODULES = sorted(path for folder in ("cellapp", "drivers") for path in (ROOT / folder).rglob("*.py"))
GROUPS = ("interfaces", "commands", "cell", "estimation", "robot", "ground")
"""From the top down: a group imports itself and those below it. ``docs`` holds chapters, ``drivers`` knows nobody."""
PURE = ("estimation", "robot")
"""Arrays in, arrays out."""
OPEN_DEVICES = (
    "cellapp.cell.driving",
    *(f"cellapp.commands.{verb}" for verb in ("doctor", "emulate", "tracker_bridge", "trials")),
)
"""Rooms that use more of the drivers than settings."""
READ_SETTINGS = ("cellapp.ground.profile", "cellapp.cell.profile", "cellapp.cell.targets")
"""Rooms that read and write what a profile or a list of targets says."""
NO_DEVICE = ("drivers.findings", "drivers.plugins", "drivers.priority")
"""What devices have said, as it is stored and shown; how all registries find plug-ins, those of effects as well; how a
thread is preferred, one that reads keys as well. None of them knows a device."""
SETTINGS = (
    "drivers.quantities",
    "drivers.settings",
    *(
        f"drivers.{folder}.{module}"
        for folder in ("arms", "trackers", "sensors")
        for module in ("registry", "settings")
    ),
)
"""What reads settings may import: how they are made, and the lists of the kinds that have some."""
DRIVERS = ("drivers.plant", "drivers.arms.ur", "drivers.trackers.lmf")
"""Some of what no command needs that only reads the profile."""
LOADED_LATER = {
    "cellapp.commands.doctor.run": "what a plan rests on is loaded when it is asked: a look loads no search",
    "cellapp.cell.profile.loader": "the mathematics is loaded where an arm has a calibration of its controller",
    "cellapp.interfaces.cli": "a command loads what it needs: --help and a stop from another window do not wait",
    "cellapp.interfaces.tui": "a screen or a job loads what it needs, in its own thread",
    "cellapp.interfaces.page": "the terminal application reads the state of a run without drawing its page",
    "cellapp.interfaces.python": "pandas and matplotlib are loaded by who asks for a table or a chart",
    "cellapp.commands.record": "a verb's run and view are loaded when it runs; words of errors on an error",
    "cellapp.commands.init.request": "starters are read where one has to be named",
    "cellapp.commands.calibrate.run": "the fit of recordings is loaded where some were made",
    "cellapp.commands.init.run": "a profile is written without what the demonstration runs",
    "cellapp.commands.docs": "chapters are read without the mathematics and the results of every verb",
    **{
        f"drivers.{module}": "a profile is read without any driver"
        for module in (
            "arms.simulated_settings",
            "arms.ur_settings",
            "sensors.serial_settings",
            "sensors.simulated_settings",
            "trackers.bridge_settings",
            "trackers.lmf_settings",
            "trackers.simulated_settings",
        )
    },
}
"""Modules and packages that import this house inside functions, for a faster start; all others do at the top."""
BROUGHT_ALONG = {
    "pydantic_core": ["pydantic"],
    "markupsafe": ["jinja2"],
    "coal": ["coal"],
    "fcl": ["python-fcl"],
    "rtde_control": ["ur-rtde"],
    "rtde_receive": ["ur-rtde"],
    "script_client": ["ur-rtde"],
}
"""Modules that no installed package names as its own, and those of packages that a declared one needs."""


@functools.cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file's syntax, parsed once."""
    return tuple(ast.walk(ast.parse(path.read_text("utf-8"))))


@pytest.fixture(scope="module", autouse=True)
def _syntax_is_forgotten() -> Iterator[None]:
    """Half a million nodes would slow every later collection of garbage."""
    yield
    nodes_of.cache_clear()
    import_nodes.cache_clear()


@functools.cache
def import_nodes(path: Path) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """The statements of import among them: one node of a hundred."""
    return tuple(node for node in nodes_of(path) if isinstance(node, ast.Import | ast.ImportFrom))


@functools.cache
def imported(path: Path) -> tuple[str, ...]:
    """Every module that a file imports, at its top, inside a function or for its types, in full dotted names."""
    return tuple(name for node in import_nodes(path) for name in _imports(path, node))


def _imports(path: Path, node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    else:
        package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
        module = ".".join([*package, *([node.module] if node.module else [])])
        yield module
        yield from (f"{module}.{alias.name}" for alias in node.names)


def imports_of(path: Path, package: str) -> list[str]:
    return [name for name in imported(path) if name == package or name.startswith(f"{package}.")]


def is_ours(module: str) -> bool:
    """Whether there is such a module or package."""
    path = ROOT.joinpath(*module.split("."))
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def place(path: Path, node: ast.AST) -> str:
    """File and line; made for the few nodes that are judged, not for all of half a million."""
    return f"{name(path)}:{getattr(node, 'lineno', 0)}"


def modules_below(folder: str) -> list[Path]:
    """The modules of a folder and all below; there are some."""
    found = [path for path in MODULES if name(path).startswith(f"{folder}/")]
    assert found
    return found


def module_of(path: Path) -> str:
    """Dotted name of a file; of a package without its ``__init__``."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@functools.cache
def imports_between_files() -> dict[str, frozenset[str]]:
    """Module -> the modules of this house that it imports anywhere; a name that it takes counts for its module."""
    ours = {module_of(path) for path in MODULES}
    found: dict[str, frozenset[str]] = {}
    for path in MODULES:
        named = set()
        for node in import_nodes(path):
            modules = [module for module in _imports(path, node) if module in ours]
            if isinstance(node, ast.ImportFrom) and len(modules) > 1:
                modules = modules[1:] if len(modules) > len(node.names) else modules
            named |= set(modules)
        found[module_of(path)] = frozenset(named - {module_of(path)})
    return found


def room_of(module: str) -> str:
    """Folder or file directly in a group of the program, or in ``drivers``."""
    return ".".join(module.split(".")[:3])


def circles(imports: Mapping[str, Collection[str]]) -> list[list[str]]:
    """What imports itself through others: groups of names, each of which leads to all of its group."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        open_ = [start]
        while open_:
            new = set(imports.get(open_.pop(), ())) - seen
            seen |= new
            open_ += new
        return seen

    leads = {name: reached(name) for name in imports}
    found = {tuple(sorted(other for other in leads[name] if name in leads.get(other, ()))) for name in leads}
    return [list(one) for one in sorted(found) if one]


def test_the_modules_are_found() -> None:
    names = {name(path) for path in MODULES}
    assert {"cellapp/interfaces/cli/app.py", "cellapp/robot/kinematics/chain.py", "drivers/plant/plant.py"} <= names
    assert imports_of(ROOT / "cellapp/cell/driving/cell.py", "drivers") != []
    late = imported(ROOT / "cellapp/interfaces/cli/top.py")
    assert "cellapp.interfaces.tui" in late, "imports inside functions count"


def test_every_name_in_these_rules_is_a_module() -> None:
    """A rule about a module that was renamed would hold whatever is written."""
    groups = [f"cellapp.{group}" for group in GROUPS]
    named = (*groups, *OPEN_DEVICES, *READ_SETTINGS, *SETTINGS, *DRIVERS, *LOADED_LATER, *NO_DEVICE)
    assert [module for module in named if not is_ours(module)] == []
    assert not is_ours("cellapp.cell.run.csv_io")
    assert {path.parent.name for path in (ROOT / "cellapp").glob("*/__init__.py")} == {*GROUPS, "docs"}


def test_imports_go_down() -> None:
    for module, others in imports_between_files().items():
        group = module.split(".")[1] if module.startswith("cellapp.") else ""
        if group in GROUPS:
            above = tuple(f"cellapp.{one}." for one in GROUPS[: GROUPS.index(group)])
            assert [other for other in others if f"{other}.".startswith(above)] == [], module


def test_no_files_import_each_other() -> None:
    assert circles({"a": ["b"], "b": ["c"], "c": ["b"], "d": ["a"]}) == [["b", "c"]]
    assert circles(imports_between_files()) == []


def test_no_rooms_import_each_other() -> None:
    rooms: dict[str, set[str]] = {}
    for module, others in imports_between_files().items():
        room = room_of(module)
        rooms.setdefault(room, set()).update({room_of(one) for one in others} - {room})
    assert circles(rooms) == []


def test_late_imports_are_for_start_up() -> None:
    """An import inside a function hides what a module rests on; it is there for a faster start or not at all."""
    found = set()
    for path in MODULES:
        functions = [one for one in nodes_of(path) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)]
        late = [one for one in import_nodes(path) if any(_holds(function, one) for function in functions)]
        if any(is_ours(module) for node in late for module in _imports(path, node)):
            module = module_of(path)
            found.add(next((one for one in LOADED_LATER if f"{module}.".startswith(f"{one}.")), module))
    assert found == set(LOADED_LATER)


def _holds(function: ast.FunctionDef | ast.AsyncFunctionDef, node: ast.stmt) -> bool:
    """Whether a statement stands in a function, by its lines."""
    return function.lineno <= node.lineno <= (function.end_lineno or 0)


def test_drivers_stand_alone() -> None:
    for path in modules_below("drivers"):
        assert imports_of(path, "cellapp") == [], name(path)
        assert imports_of(path, "tests") == [], name(path)


def test_the_plant_knows_no_driver_either() -> None:
    for path in modules_below("drivers/plant"):
        found = imports_of(path, "drivers")
        assert [module for module in found if not module.startswith("drivers.plant")] == [], name(path)


def test_only_some_rooms_read_settings_and_fewer_open_devices() -> None:
    for path in modules_below("cellapp"):
        module = f"{module_of(path)}."
        if module.startswith(tuple(f"{room}." for room in OPEN_DEVICES)):
            continue
        reads = module.startswith(tuple(f"{room}." for room in READ_SETTINGS))
        allowed = tuple(f"{one}." for one in (*NO_DEVICE, *(SETTINGS if reads else ())))
        found = imports_of(path, "drivers")
        assert [one for one in found if not f"{one}.".startswith(allowed)] == [], name(path)


def test_loading_the_profile_loads_no_driver() -> None:
    """Settings modules import neither numpy nor a device library, so that every command starts fast."""
    heavy = {"numpy", "serial", "rtde_control", "clr", *DRIVERS}
    code = f"import sys, cellapp.cell.profile; sys.exit(', '.join({heavy} & sys.modules.keys()) or None)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_generic_code_compares_no_kinds_of_devices() -> None:
    """A kind brings what generic code asks about it: ``needs_plant``, ``has_device`` and the like."""
    for path in (ROOT / "cellapp").rglob("*.py"):
        for node in nodes_of(path):
            parts = [node.left, *node.comparators] if isinstance(node, ast.Compare) else []
            parts = [node.subject] if isinstance(node, ast.Match) else parts
            for part in parts:
                if isinstance(part, ast.Attribute) and part.attr == "kind":
                    assert not ast.unparse(part).endswith("driver.kind"), place(path, node)


def test_mathematics_opens_no_file() -> None:
    """But a model reads and writes its own: ``CellModel.load`` is how a program without a run comes to one."""
    opening = {"open", "file_text", "read_text", "write_text", "read_bytes", "write_bytes", "mkdir", "unlink"}
    found = set()
    for path in (path for group in PURE for path in modules_below(f"cellapp/{group}")):
        called = [node.func for node in nodes_of(path) if isinstance(node, ast.Call)]
        names = {ast.unparse(one).rpartition(".")[2] for one in called if isinstance(one, ast.Name | ast.Attribute)}
        found |= {(name(path), one) for one in names & opening}
    assert found == {("cellapp/robot/model/model.py", "file_text"), ("cellapp/robot/model/model.py", "write_text")}


def test_json_goes_through_the_typed_results() -> None:
    """Results are typed; no object of its own makes a dictionary for JSON."""
    for path in modules_below("cellapp"):
        functions = [node.name for node in nodes_of(path) if isinstance(node, ast.FunctionDef)]
        assert "as_dict" not in functions, name(path)


def test_doors_are_used_by_nobody_inside() -> None:
    for path in MODULES:
        if name(path) != "cellapp/__main__.py" and not name(path).startswith("cellapp/interfaces/cli/"):
            assert imports_of(path, "cellapp.interfaces.cli") == [], name(path)
            if not name(path).startswith("cellapp/interfaces/tui/"):
                assert imports_of(path, "cellapp.interfaces.tui") == [], name(path)


def test_nothing_that_runs_foreign_code_or_hides_errors() -> None:
    for path in MODULES:
        for module in ("pickle", "cPickle", "dill", "shelve", "marshal", "joblib"):
            assert imports_of(path, module) == [], name(path)
        for node in nodes_of(path):
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, f"{place(path, node)}: bare except"
            if isinstance(node, ast.Call):
                assert_safe_call(path, node, place(path, node))


def assert_safe_call(path: Path, node: ast.Call, where: str) -> None:
    """Assert that a call runs no code of others: no ``eval``, and files are read by safe loaders only."""
    called = ast.unparse(node.func)
    assert called not in ("eval", "exec", "os.system"), where
    assert not called.endswith((".unsafe_load", ".full_load", ".load_all", ".unsafe_load_all")), where
    if called in ("yaml.load", "yaml.compose", "yaml.parse"):
        loaders = [argument for argument in (*node.args[1:], *(key.value for key in node.keywords))]
        assert any(_is_safe(path, ast.unparse(loader)) for loader in loaders), f"{where}: no safe loader"
    if called in ("np.load", "numpy.load", "torch.load"):
        allowed = {key.arg: ast.unparse(key.value) for key in node.keywords}
        assert allowed.get("allow_pickle") == "False" or allowed.get("weights_only") == "True", where


def _is_safe(path: Path, loader: str) -> bool:
    """Whether a loader is one of YAML's safe ones or a class of this file made from one."""
    safe = ("yaml.SafeLoader", "yaml.CSafeLoader")
    if loader in safe:
        return True
    classes = [node for node in nodes_of(path) if isinstance(node, ast.ClassDef)]
    return any(node.name == loader and [ast.unparse(base) for base in node.bases] in ([safe[0]], [safe[1]])
               for node in classes)  # fmt: skip


def test_every_room_has_tests_of_its_name() -> None:
    """A room is a folder in a group of the program, or in ``drivers``; its tests are a folder or a file of its name.
    Verbs are tested where they are called, too; sections of the profile with its loader."""
    packages = [path.parent.relative_to(ROOT / "cellapp") for path in (ROOT / "cellapp").glob("*/*/__init__.py")]
    rooms = {path.as_posix() for path in packages if path.parts[0] != "commands"} - {"ground/profile"}
    rooms |= {f"drivers/{path.parent.name}" for path in (ROOT / "drivers").glob("*/__init__.py")}
    files = {path.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")}
    tested = {parent.as_posix() for path in files for parent in path.parents}
    tested |= {(path.parent / path.stem.removeprefix("test_")).as_posix() for path in files}
    assert rooms <= tested


def test_nothing_waits_by_sleeping_in_tests() -> None:
    """But trials do: a person who presses keys and strikes faults at moments of the clock."""
    for path in set((ROOT / "tests").rglob("*.py")) - set((ROOT / "tests" / "evidence").rglob("*.py")):
        text = path.read_text("utf-8")
        if "sleep" not in text:  # parsing five hundred files takes seconds
            continue
        tree = ast.parse(text)
        sleeps = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr == "sleep"]
        assert "time.sleep" not in [ast.unparse(node) for node in sleeps], path.name


def test_every_package_that_is_imported_is_declared() -> None:
    """What another package brings along by chance is missing where that changes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    listed = [*project["dependencies"], *(one for extra in project["optional-dependencies"].values() for one in extra)]
    declared = {re.split(r"[^A-Za-z0-9._-]", one, maxsplit=1)[0].lower().replace("_", "-") for one in listed}
    brought = {**metadata.packages_distributions(), **BROUGHT_ALONG}
    imported_here = {name.split(".")[0] for path in MODULES for name in imported(path)}
    others = imported_here - {"cellapp", "drivers", "tests", "__future__"} - sys.stdlib_module_names
    undeclared = {
        name for name in others if not {one.lower().replace("_", "-") for one in brought.get(name, [name])} & declared
    }
    assert undeclared == set()


def test_a_verb_is_known_to_no_interface_and_a_screen_to_the_list_of_screens_alone() -> None:
    """The toy verb has a chart and a dialog, and no interface knows them."""
    texts = {name(path): path.read_text("utf-8") for path in MODULES if name(path).startswith("cellapp/")}
    assert [one for one, text in texts.items() if "/interfaces/" in one and "greet" in text.lower()] == []
    screens = "cellapp/interfaces/tui/screens"
    for entry in SCREENS:
        naming = {one for one, text in texts.items() if re.search(rf"\b{entry.class_name}\b", text)}
        assert naming == {f"{screens}/{entry.step}.py", f"{screens}/__init__.py"}, entry.class_name


@pytest.mark.parametrize("group", sorted(set(GROUPS) - {"commands"}))
def test_the_drawing_of_the_house_shows_the_rooms_that_stand(group: str) -> None:
    chapter = (ROOT / "cellapp/docs/architecture.md").read_text("utf-8")
    line = next(line for line in chapter.splitlines() if re.match(f"{group} {{3}}", line))
    drawn = set(re.split(r" {4,}|  --->", line[13:])[0].split())
    stand = {path.parent.name for path in (ROOT / "cellapp" / group).glob("*/__init__.py")}
    modules = {path.stem for path in (ROOT / "cellapp" / group).glob("*.py")}
    assert stand <= drawn <= stand | modules


def test_the_ways_through_the_house_name_what_stands() -> None:
    chapter = (ROOT / "cellapp/docs/architecture.md").read_text("utf-8")
    ways = chapter.split("on their ways\n")[1].split("\n## ")[0]
    quoted = {word for words in re.findall(r"`([^`]+)`", ways) for word in re.split("[./]", words)}
    defined = {
        node.name for path in MODULES for node in nodes_of(path) if isinstance(node, ast.ClassDef | ast.FunctionDef)
    }
    rooms = {part for path in MODULES for part in path.relative_to(ROOT).with_suffix("").parts}
    assert quoted - defined - rooms == set()
