"""Where a station's file says that its certificate is."""

from pathlib import Path
from typing import Any

import msgspec

from stream.errors import BadInput
from stream.files.toml_text import decode_toml

_BESIDE = "security"


def station_security(path: Path | None) -> Path | None:
    """Folder of the certificate that `security` in a station's file names; None if it names none.

    ``"mtls"`` is the folder `security` beside the file. A file that cannot be read is reported by who reads it whole.
    """
    if path is None:
        return None
    try:
        file = decode_toml(path.read_bytes(), dict[str, Any])
    except (OSError, msgspec.DecodeError):
        return None
    station = file.get("station")
    named = (station.get("security") if isinstance(station, dict) else None) or file.get("security")
    if not isinstance(named, str) or not named:
        return None
    folder = path.parent / (_BESIDE if named == "mtls" else named)
    if not folder.exists():
        raise BadInput(
            f"{path}: security is {named!r}, and there is no {folder}; copy the folder that `gyrofleet site "
            f"add-station` makes there, or give --security FOLDER"
        )
    return folder
