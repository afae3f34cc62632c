"""Run documents keep their content on the wire and are told apart by their kind."""

import typing

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stream import events
from stream.errors import WireError
from stream.events import AnyDocument, EstimatePoint, EstimatePublished, StepStarted, StepWords

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
                    EstimatePoint,
                    tau_s=numbers,
                    value=numbers,
                    lo=numbers,
                    hi=numbers,
                    edf=numbers,
                    n=st.integers(0),
                ),
                max_size=3,
            ).map(tuple)
        },
        events.LimitsApplied: {"limits": st.lists(LIMITS, max_size=3).map(tuple)},
        events.EarlyDecision: {"limit": LIMITS},
        events.SpectralLinesFound: {
            "lines": st.none() | st.lists(st.dictionaries(text, numbers, max_size=3), max_size=3).map(tuple)
        },
        events.VerdictGiven: {"verdict": st.sampled_from(events.Verdict)},
    }
    return st.builds(kind, **fields, **nested.get(kind, {}))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_a_document_decodes_to_itself(kind: type) -> None:
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
