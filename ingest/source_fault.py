"""What a source of samples knows to be wrong with those of a unit."""

from enum import Enum


class Fault(Enum):
    """A fault, with what it means for samples that lack."""

    INTERVAL = "its interval_s is wrong, see the warning"
    NOT_READ = "it was not read while there was no room for its samples"
    NO_FRAME = "what came made no frame: check its layout and baud"
