"""Names of VISA resources, looked over before anything is opened."""

import difflib
import re

_BUILT_IN = ("TCPIP", "ASRL", "GPIB", "USB")
_INTERFACES = (*_BUILT_IN, "VXI", "PXI", "VICP", "PRLGX-TCPIP", "PRLGX-ASRL")
_EXAMPLES = "TCPIP::192.168.1.20::5025::SOCKET, ASRL/dev/ttyUSB0::INSTR or GPIB0::8::INSTR"


def resource_trouble(resource: str) -> str | None:
    """Why a text cannot be the name of a resource, and what to write; None where it can.

    A name without a colon may be an alias that a vendor's library knows.

    Examples
    --------
    >>> resource_trouble("TCPI::192.168.1.20::5025::SOCKET")
    "VISA knows no interface 'TCPI', did you mean TCPIP?"
    >>> resource_trouble("TCPIP::192.168.1.20::5025::SOCKET"), resource_trouble("chamber")
    (None, None)
    """
    if not resource.strip():
        return f"it is empty; write it as {_EXAMPLES}"
    if ":" not in resource:
        return None
    upper = resource.upper()
    if not upper.startswith(_INTERFACES):
        given = re.split(r"\d*:|/", upper, maxsplit=1)[0]
        near = difflib.get_close_matches(given, _INTERFACES, n=1)
        hint = f"did you mean {near[0]}?" if near else f"write it as {_EXAMPLES}"
        return f"VISA knows no interface {given!r}, {hint}"
    from pyvisa.rname import InvalidResourceName, ResourceName

    try:
        ResourceName.from_string(resource)
    except InvalidResourceName as error:
        # of other interfaces pyvisa does not know every form that a vendor's library takes
        return f"{error}; write it as {_EXAMPLES}" if upper.startswith(_BUILT_IN) else None
    return None
