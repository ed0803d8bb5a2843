"""Calibration of a dual-arm robot cell with a laser tracker.

    import cellapp

    fit = cellapp.Cell.load("cell.yaml").calibrate("readings.csv")
    found = fit.discover()
    print(found.report())

Arrays carry n configurations at once, float64, in SI units. ``T_M_B`` maps coordinates of frame B into frame M:
M is the tracker, B a robot base, F a flange, S the centre of the retroreflector (SMR), C the cell floor.
``cellapp docs python`` is the chapter about this library.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from cellapp.ground.version import __version__ as __version__

if TYPE_CHECKING:
    from cellapp import api as api
    from cellapp import dataframes as dataframes
    from cellapp.ground.errors import CellappError as CellappError
    from cellapp.ground.errors import InputError as InputError
    from cellapp.interfaces.python.api import Run as Run
    from cellapp.interfaces.python.api import open_run as open_run
    from cellapp.interfaces.python.cell import Calibration as Calibration
    from cellapp.interfaces.python.cell import Cell as Cell
    from cellapp.interfaces.python.cell import CellReadings as CellReadings
    from cellapp.interfaces.python.cell import Compensation as Compensation
    from cellapp.interfaces.python.cell import Discovery as Discovery
    from cellapp.robot.model import CellModel as CellModel


_HOMES = {
    "Calibration": "cellapp.interfaces.python.cell",
    "Cell": "cellapp.interfaces.python.cell",
    "CellModel": "cellapp.robot.model",
    "CellReadings": "cellapp.interfaces.python.cell",
    "CellappError": "cellapp.ground.errors",
    "Compensation": "cellapp.interfaces.python.cell",
    "Discovery": "cellapp.interfaces.python.cell",
    "InputError": "cellapp.ground.errors",
    "Run": "cellapp.interfaces.python.api",
    "open_run": "cellapp.interfaces.python.api",
}
"""Where each public name lives. It is imported when it is first asked for: commands and drivers need none of them."""
_MODULES = ("api", "dataframes")
"""Modules that are attributes before anything imports them."""


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(f"cellapp.{name}")
    if name not in _HOMES:
        raise AttributeError(f"module 'cellapp' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES, *_MODULES})
