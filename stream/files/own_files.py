"""A site's own files beside those of the program: its metrics, instruments, effects and conditions of alerts.

The environment variable ``GYROFLEET_OWN`` names a folder, or several as PATH does. Its folders `metrics`,
`instruments`, `effects` and `conditions` belong to the packages of these, and stay where the program is upgraded.
"""

import importlib
import os
from collections.abc import MutableSequence
from pathlib import Path
from types import ModuleType

from stream.errors import BadInput, GyrofleetError

VARIABLE = "GYROFLEET_OWN"
ROOMS = ("metrics", "instruments", "effects", "conditions")


def add_own(path: MutableSequence[str], room: str) -> None:
    """Add the site's folders to the path of a package; BadInput if one is missing, or has a file of the program's name.

    >>> path = ["analytics/metrics"]
    >>> add_own(path, "metrics")  # without GYROFLEET_OWN
    >>> path
    ['analytics/metrics']
    """
    for text in _named():
        folder = Path(text).absolute()
        if not any((folder / each).is_dir() for each in ROOMS):
            raise BadInput(
                f"{VARIABLE} names {text}, where none of the folders {', '.join(ROOMS)} is: name the folder above them"
            )
        if not (folder / room).is_dir():
            continue
        own = {each.name for each in (folder / room).iterdir()} - {"__init__.py", "__pycache__"}
        for number, other in enumerate(path):
            if twice := sorted(own & {each.name for each in Path(other).iterdir()}):
                whose = f"a file in {other}" if number else "a file of gyrofleet"
                raise BadInput(f"{folder / room / twice[0]} has the name of {whose}: give it another one")
        path.append(str(folder / room))


def _named() -> list[str]:
    return [each for each in os.environ.get(VARIABLE, "").split(os.pathsep) if each]


def own_folders() -> list[Path]:
    """The folders in which files of the site's own are.

    >>> own_folders()  # without GYROFLEET_OWN
    []
    """
    rooms = (Path(text).absolute() / room for text in _named() for room in ROOMS)
    return [each for each in rooms if each.is_dir()]


def files_of(package: str) -> list[Path]:
    """Files of a package, the site's own among them, in the order of their names."""
    folders = importlib.import_module(package).__path__
    found = [each for folder in folders for each in Path(folder).iterdir() if each.is_file()]
    return sorted(found, key=lambda each: each.name)


def is_own(package: str, file: Path) -> bool:
    """Whether a file of a package is the site's own.

    >>> is_own("stream.files", Path(__file__))
    False
    """
    return str(file.parent) in list(importlib.import_module(package).__path__)[1:]


def imported(package: str, module: str) -> ModuleType:
    """A module of a package; BadInput names a file of the site's own that cannot be imported.

    >>> imported("stream.files", "own_files").VARIABLE
    'GYROFLEET_OWN'
    """
    try:
        return importlib.import_module(f"{package}.{module}")
    except GyrofleetError:
        raise
    except Exception as error:
        own = [Path(folder) / f"{module}.py" for folder in list(importlib.import_module(package).__path__)[1:]]
        if path := next((each for each in own if each.exists()), None):
            raise BadInput(f"{path} cannot be imported: {type(error).__name__}: {error}") from error
        raise
