"""What a format of files is to the fuzzer, and the register of all of them."""

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import tests.fuzz.formats
from tests.fuzz.mutations import Mutation


@dataclass(frozen=True)
class Format:
    """A format that gyrofleet reads.

    Parameters
    ----------
    name : str
        Its name; the folder of inputs that once were findings is ``found/NAME``.
    seeds : Callable
        Makes sound contents, as the real writer writes them; the folder is for what the writer needs.
    read : Callable
        Reads the file at a path to its end, as the commands do.
    mutate : Mutation
        Changes a content.
    file : str or Callable
        Path of the file in its folder; a function of the content where the name depends on it.
    around : Callable, optional
        Writes what belongs around the file into the folder, once.
    changes : bool
        Whether reading changes what is in the folder, which is then made again for each input.
    gate_inputs : int
        Inputs of a short campaign; the gate has a part of them.
    hang_s : float
        Seconds after which reading counts as a hang.
    """

    name: str
    seeds: Callable[[Path], Sequence[bytes]]
    read: Callable[[Path], object]
    mutate: Mutation
    file: str | Callable[[bytes], str]
    around: Callable[[Path], None] | None = None
    changes: bool = False
    gate_inputs: int = 200
    hang_s: float = 10.0

    def path(self, content: bytes) -> str:
        """Path of the file of a content in its folder."""
        return self.file if isinstance(self.file, str) else self.file(content)


@cache
def formats() -> Mapping[str, Format]:
    """Every format by name: the lists `FORMATS` of the modules in `tests/fuzz/formats`."""
    found: dict[str, Format] = {}
    for module in sorted(pkgutil.iter_modules(tests.fuzz.formats.__path__), key=lambda each: each.name):
        for each in importlib.import_module(f"tests.fuzz.formats.{module.name}").FORMATS:
            assert each.name not in found, f"two formats are named {each.name}"
            found[each.name] = each
    return found
