"""Rules of a site (``site.toml``): which acts need two persons."""

from enum import StrEnum
from pathlib import Path

import msgspec

from stream.errors import BadInput
from stream.files.toml_text import decode_toml

RULES_FILE = "site.toml"


class Subject(StrEnum):
    """What two persons have to agree on."""

    MODELS = "models"
    SPECIFICATIONS = "specifications"
    CERTIFICATES = "certificates"


class SiteRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of the file."""

    two_persons: tuple[Subject, ...] = ()


def read_site_rules(path: Path) -> SiteRules:
    """The rules of a file, none if there is no file; BadInput names the key that is wrong.

    >>> read_site_rules(Path("/nowhere/site.toml"))
    SiteRules(two_persons=())
    """
    try:
        return decode_toml(path.read_bytes(), SiteRules)
    except FileNotFoundError:
        return SiteRules()
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or error}") from error
    except msgspec.MsgspecError as error:
        known = ", ".join(f'"{each}"' for each in Subject)
        raise BadInput(f"{path}: {error}; two_persons is a list of some of {known}") from error
