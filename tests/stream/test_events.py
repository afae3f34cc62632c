"""Run documents keep their content on the wire and are distinguished by their kind."""

import typing

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stream import events
from stream.errors import WireError
from stream.events import (
    AnyDocument,
    EstimatePoint,
    EstimatePublished,
    NoteAdded,
    RunEnded,
    StepStarted,
    StepWords,
    StoreNoted,
    StreamTotal,
)
from stream.wire.event_validation import decode_received

KINDS = typing.get_args(AnyDocument)
text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
numbers = st.floats(allow_nan=False, allow_infinity=False)
LIMITS = st.builds(
    events.Limit, characteristic=text, signal=text, tau_s=st.none() | numbers, upper=numbers, unit_of_measure=text
)


def of(kind: type) -> st.SearchStrategy[typing.Any]:
    """Documents of a kind with arbitrary content, from the types of its fields."""
    by_type: dict[typing.Any, st.SearchStrategy[typing.Any]] = {
        str: text,
        int: st.integers(-(2**62), 2**62),
        events.Moment: st.integers(-(2**63) + 1, 2**63 - 1),
        bool: st.booleans(),
        float: numbers,
        str | None: st.none() | text,
        float | None: st.none() | numbers,
    }
    fields = {field.name: by_type[field.type] for field in msgspec.structs.fields(kind) if field.type in by_type}
    nested: dict[type, dict[str, st.SearchStrategy[typing.Any]]] = {
        StepStarted: {"words": st.builds(StepWords, step=text, repeat=st.none() | st.integers(0, 9), settle_s=numbers)},
        EstimatePublished: {
            "points": st.lists(
                st.builds(
                    EstimatePoint, tau_s=numbers, value=numbers, lo=numbers, hi=numbers, edf=numbers, n=st.integers(0)
                ),
                max_size=3,
            ).map(tuple)
        },
        events.LimitsApplied: {"limits": st.lists(LIMITS, max_size=3).map(tuple)},
        events.EarlyDecision: {"limit": LIMITS},
        events.SpectralLinesFound: {
            "lines": st.none() | st.lists(st.dictionaries(text, numbers, max_size=3), max_size=3).map(tuple)
        },
        events.SpecificationEntered: {
            "action": st.sampled_from(events.SpecificationAction),
            "settles": st.lists(text, max_size=3).map(tuple),
        },
        events.VerdictGiven: {"verdict": st.sampled_from(events.Verdict)},
    }
    return st.builds(kind, **fields, **nested.get(kind, {}))


@pytest.mark.parametrize("examples", [10, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_document_decodes_to_itself(kind: type, examples: int) -> None:
    @settings(max_examples=examples)
    @given(of(kind), st.integers(0, 2**62))
    def check(document: AnyDocument, seq: int) -> None:
        message = events.decode_event(events.encode_event(document, "e", seq))
        assert message.document == document
        assert type(message.document) is kind
        assert (message.epoch, message.seq) == ("e", seq)

    check()


def test_an_unknown_kind_is_refused() -> None:
    payload = b'{"schema":1,"epoch":"e","seq":0,"document":{"kind":"Invented","run":"r","t_ns":0}}'
    with pytest.raises(WireError, match="Invented"):
        events.decode_event(payload)


def test_the_schema_names_every_kind() -> None:
    schema = msgspec.json.encode(events.document_schema()).decode()
    assert all(f'"{kind.__name__}"' in schema for kind in KINDS)


EPOCH = "00000000-0000-0000-0000-000000000001"
STRETCH = {"key": "k", "epoch": "e", "first_seq": 0, "last_seq": 9, "first_ns": None, "last_ns": 5}


def ended(**changed: typing.Any) -> RunEnded:
    total = {"unit": "U1", "signal": "rate", "epoch": EPOCH, "samples": 7, **changed}
    return RunEnded(run="r1", t_ns=0, totals=(StreamTotal(**total),))


def noted(what: str = "numbers_missing", **details: typing.Any) -> StoreNoted:
    return StoreNoted(run="", t_ns=0, what=what, text="", details=details)


@pytest.mark.parametrize(
    "document",
    [
        ended(epoch="zzz"),
        ended(epoch=""),
        ended(unit="a/b"),
        ended(signal=""),
        ended(samples=-1),
        ended(samples=2**62),
        noted(lost=7),
        noted(lost=[1, 2]),
        noted(lost=[{"key": [1]}]),
        noted(lost=[STRETCH | {"first_seq": "0"}]),
        noted(lost=[STRETCH | {"epoch": ["e"]}]),
        noted("raw_rows_dropped"),
        noted("raw_rows_dropped", segments="00000001"),
        noted("raw_rows_dropped", segments=[["00000001"]]),
        noted(segments=None),
        noted(store=7),
    ],
)
def test_a_document_that_makes_no_sense_is_refused_on_arrival(document: AnyDocument) -> None:
    payload = events.encode_event(document, "e", 0)
    assert events.decode_event(payload).document == document  # a log that holds it can be read all the same
    with pytest.raises(WireError, match="not a run document"):
        decode_received(payload)


@pytest.mark.parametrize(
    "document",
    [
        ended(),
        ended(epoch=EPOCH.replace("-", ""), samples=0),
        noted(),
        noted(lost=[STRETCH]),
        noted(lost=[], store="s"),
        noted("raw_rows_dropped", segments=["00000001"]),
    ],
)
def test_a_document_that_makes_sense_is_taken(document: AnyDocument) -> None:
    assert decode_received(events.encode_event(document, EPOCH, 0)).document == document


@pytest.mark.parametrize("epoch", ["", "a b", "a\n", "a" * 65, "\u00e9"])
def test_an_epoch_that_cannot_be_a_mark_is_refused(epoch: str) -> None:
    with pytest.raises(WireError, match="epoch"):
        decode_received(events.encode_event(NoteAdded(run="r1", t_ns=0, text=""), epoch, 0))
