"""Blocks of a large manifest: the parts whose first segments have neighbouring numbers, in one immutable file.

A block's borders depend on the numbers alone, so that a change rewrites the few blocks that it touches, however many
there are. SHA-256 of the segments stand apart from the parts: only who compares a lake with a log decodes them.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping

import msgspec
import zstandard

from storage.manifests.part import Part, check_names
from stream.decoding import json_decoder

SPAN = 4096  # segments
_LEVEL = 3
_MOST_BYTES = 1 << 30
_MOST_NAMES = 10_000_000


class _Block(msgspec.Struct, frozen=True):
    parts: list[Part]
    sources: msgspec.Raw = msgspec.Raw(b"{}")


_decoder = json_decoder(_Block)
_sources = json_decoder(dict[str, str])


def in_blocks(parts: Iterable[Part]) -> dict[int, list[Part]]:
    """Parts by the number of their block, in their order."""
    blocks: defaultdict[int, list[Part]] = defaultdict(list)
    for part in parts:
        first = part.segments[0]
        blocks[int(first) // SPAN if first.isdecimal() else 0].append(part)
    return dict(blocks)


def encode_block(parts: Iterable[Part]) -> bytes:
    """The content of a block.

    >>> part = Part(name="00000007", segments=("00000007",), files={}, samples=3, sources={"00000007": "ab"})
    >>> decode_block(encode_block([part]), with_sources=True) == [part]
    True
    """
    parts = list(parts)
    sources = {segment: sha256 for part in parts for segment, sha256 in part.sources.items()}
    block = _Block([msgspec.structs.replace(part, sources={}) for part in parts], msgspec.Raw(_encoded(sources)))
    return zstandard.ZstdCompressor(level=_LEVEL).compress(_encoded(block))


def decode_block(content: bytes, *, with_sources: bool = False) -> list[Part]:
    """The parts in a block, `with_sources` with the SHA-256 of their segments; ValueError if it is damaged."""
    try:
        if (stated := zstandard.frame_content_size(content)) > _MOST_BYTES:  # which is allocated as it is stated
            raise ValueError(f"it states {stated:,} bytes, a block has at most {_MOST_BYTES:,}")
        text = zstandard.ZstdDecompressor().decompress(content, max_output_size=_MOST_BYTES)
        block = _decoder.decode(text)
        sources: Mapping[str, str] = _sources.decode(block.sources) if with_sources else {}
    except (zstandard.ZstdError, msgspec.MsgspecError, RecursionError) as error:
        raise ValueError(str(error)) from error
    except MemoryError as error:
        raise ValueError("it takes more memory than there is") from error
    for part in block.parts:
        check_names(part)
    if not with_sources:
        return block.parts
    return [
        msgspec.structs.replace(part, sources={each: sources[each] for each in part.segments if each in sources})
        for part in block.parts
    ]


def _encoded(value: object) -> bytes:
    return msgspec.json.encode(value)


def packed(segments: Iterable[str]) -> list[str]:
    """Sorted names, with those of consecutive numbers as ``first-last``.

    >>> packed(["00000001", "00000002", "00000003", "00000007"])
    ['00000001-00000003', '00000007']
    """
    runs: list[list[str]] = []
    for each in sorted(set(segments)):
        if runs and each.isdecimal() and each == f"{int(runs[-1][-1]) + 1:0{len(each)}d}":
            runs[-1][1:] = [each]
        else:
            runs.append([each])
    return ["-".join(run) for run in runs]


def unpacked(ranges: Iterable[str]) -> list[str]:
    """The names of `packed`; ValueError if they are more than any log has.

    >>> unpacked(["00000001-00000003", "00000007"])
    ['00000001', '00000002', '00000003', '00000007']
    """
    found: list[str] = []
    for each in ranges:
        first, _, last = each.partition("-")
        is_run = first.isdecimal() and last.isdecimal()
        if is_run and int(last) - int(first) + len(found) > _MOST_NAMES:
            raise ValueError(f"{each[:80]!r} names more than {_MOST_NAMES:,} segments")
        found += [f"{n:0{len(first)}d}" for n in range(int(first), int(last) + 1)] if is_run else [each]
    return found
