"""Catalogues shared by requests: one of each version, those before it no longer than they are used."""

import time
from dataclasses import dataclass

from analytics.serve.shared_lake import LakeState, SharedCatalogue
from stream.closing import Closing

FIRST, SECOND = LakeState("1-a-0", 1, ()), LakeState("2-b-0", 2, ())


@dataclass
class Catalogue(Closing):
    """Counts those that are open."""

    is_open: bool = True

    def close(self) -> None:
        self.is_open = False


def test_a_request_of_the_version_before_opens_nothing_again() -> None:
    opened: list[LakeState] = []

    def open_one(state: LakeState) -> Catalogue:
        opened.append(state)
        return Catalogue()

    with SharedCatalogue(open_one, lingers_s=0.2) as shared:
        with shared.lease(FIRST) as before, shared.lease(SECOND) as current, shared.lease(FIRST) as again:
            assert again is before is not current
        assert (opened, before.is_open, shared.state) == ([FIRST, SECOND], True, SECOND)
        time.sleep(0.25)
        shared.sweep()
        assert (before.is_open, current.is_open) == (False, True)
        with shared.lease(SECOND) as same:
            assert same is current
    assert not current.is_open


def test_a_catalogue_in_use_stays_open_until_it_is_given_back() -> None:
    with SharedCatalogue(lambda _: Catalogue(), lingers_s=0.0) as shared:
        seen = []
        with shared.lease(FIRST) as before:
            with shared.lease(SECOND):
                pass
            shared.sweep()
            seen.append(before.is_open)
        seen.append(before.is_open)
        with shared.lease(SECOND) as current:
            shared.close()
            seen.append(current.is_open)
        seen.append(current.is_open)
        assert seen == [True, False, True, False]


def test_later_rows_of_the_log_are_another_version() -> None:
    state = LakeState("1-a-0", 1, (), log_version=4)
    assert state.lake == FIRST
    assert state.is_newer_than(FIRST)
    assert not FIRST.has_all_of(state)
    assert state.has_all_of(FIRST)
