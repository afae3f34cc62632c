"""A jump beside outputs of the unit that are no channels: whether these step at the same time is not examined."""

from collections.abc import Sequence

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.reduction_notes import OUTPUT, Note
from analytics.loop.tracing.result.diagnosis_result import Diagnosis
from analytics.loop.tracing.search.fitted_candidates import JUMP


def with_unread_outputs(diagnosis: Diagnosis, notes: Sequence[Note]) -> Diagnosis:
    """The diagnosis; where a jump was found, with the outputs that are not compared with it."""
    if not any(each.name == JUMP for each in (*diagnosis.effects, *diagnosis.unreplicated)):
        return diagnosis
    limits = tuple(
        Bilingual(
            f"a jump may be a step of what another output shows, which is not compared with it: {note.text}",
            f"跳变也可能是其他输出所示的阶跃，未与之比较：{note.text.zh}",
        )
        for note in notes
        if note.what == OUTPUT
    )
    return msgspec.structs.replace(diagnosis, limits=(*diagnosis.limits, *limits))
