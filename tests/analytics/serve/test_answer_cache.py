"""Kept answers: each made once for all who wait, given on while the next one is made, and no error kept."""

import asyncio

import pytest

from analytics.serve.answer_cache import Answer, AnswerCache

KEY = ("page",)


class Maker:
    """Answers by their number; each takes a moment, the `failing` ones fail."""

    def __init__(self, *failing: int) -> None:
        self.made, self._failing = 0, failing

    async def __call__(self) -> Answer:
        self.made += 1
        number = self.made
        await asyncio.sleep(0.01)
        if number in self._failing:
            raise LookupError(number)
        return Answer(str(number).encode(), "text/plain")


async def bodies(cache: AnswerCache, make: Maker, count: int, most_s: float, stale_s: float) -> list[str]:
    found = await asyncio.gather(*(cache.answer(KEY, make, most_s, stale_s=stale_s) for _ in range(count)))
    return [each.body.decode() for each in found]


def test_who_asks_meanwhile_gets_the_same_answer() -> None:
    make = Maker()
    assert asyncio.run(bodies(AnswerCache(), make, 5, 60.0, 0.0)) == ["1"] * 5
    assert make.made == 1


def test_a_stale_answer_is_given_while_one_new_one_is_made() -> None:
    async def run() -> None:
        cache, make = AnswerCache(), Maker()
        assert await bodies(cache, make, 1, 0.0, 60.0) == ["1"]
        assert await bodies(cache, make, 5, 0.0, 60.0) == ["1"] * 5
        assert make.made == 2
        await asyncio.sleep(0.05)
        assert await bodies(cache, make, 1, 60.0, 0.0) == ["2"]
        assert await bodies(cache, make, 1, 0.0, 0.0) == ["3"], "beyond both nothing old is given"

    asyncio.run(run())


def test_an_error_is_of_those_who_wait_for_it_and_is_not_kept() -> None:
    async def run() -> None:
        cache, make = AnswerCache(), Maker(1, 3)
        with pytest.raises(LookupError):
            await bodies(cache, make, 2, 60.0, 60.0)
        assert await bodies(cache, make, 1, 0.0, 60.0) == ["2"]
        assert await bodies(cache, make, 1, 0.0, 60.0) == ["2"], "the third fails behind it"
        await asyncio.sleep(0.05)
        assert await bodies(cache, make, 1, 0.0, 60.0) == ["2"]
        await asyncio.sleep(0.05)
        assert await bodies(cache, make, 1, 60.0, 0.0) == ["4"]

    asyncio.run(run())
