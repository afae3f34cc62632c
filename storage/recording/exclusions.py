"""Exclusions of runs, of units of them, and of checks by hand from evaluation, as documents."""

import time
from typing import NamedTuple

from storage.recording.client import record_documents
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput, NotFound
from stream.events import ExclusionAction, ExclusionEntered
from stream.identity import Place
from stream.security.actor import Actor

_MOST_TEXT = 1000
_PATIENCE_S = 15.0
_UNITS = """
with tested as (
  select run, unit from steps union select run, unit from units
)
select t.unit, x.reason from tested t left join exclusions x on x.run = t.run and x.unit = t.unit
where t.run = $run order by t.unit
"""
_CHECK = """
select c.unit, c.run, (
    select arg_max(x.document->>'$.action', x.t_ns) from events x
    where x.kind = 'ExclusionEntered' and x.document->>'$.check' = c.uid) as action
from events c where c.kind = 'CheckEntered' and c.uid = $uid
"""


class Exclusion(NamedTuple):
    """Units that an act changed, those that were as it wants them, its documents, and whether evaluations follow it.

    They do once its documents are in the lake, for which it is waited some seconds.
    """

    changed: list[str]
    others: list[str]
    documents: tuple[ExclusionEntered, ...]
    is_in_lake: bool


class _Targets(NamedTuple):
    """Units that an act changes, those that are as it wants them, and what its documents name: run, unit, check."""

    changed: list[str]
    others: list[str]
    named: list[tuple[str, str | None, str]]


def enter_exclusion(
    store: Store, action: ExclusionAction, reason: str, actor: Actor, *, role: str, run: str | None = None,
    units: tuple[str, ...] = (), check: str | None = None,
) -> Exclusion:  # fmt: skip
    """Exclude a run, some `units` of it, or a `check` by its uid, or include it again; on disk when this returns.

    Evaluations follow it then, if a recorder at work brings it to the lake in some seconds (`Exclusion.is_in_lake`).

    BadInput if it names neither or both, or the reason is empty; NotFound where there is no such run, unit or check.
    `role` is who writes, for the message that another writer gets.
    """
    reason = reason.strip()
    if not reason or len(reason) > _MOST_TEXT:
        raise BadInput(f"the reason has {len(reason)} characters; say why, in 1 to {_MOST_TEXT}")
    if (run is None) is (check is None) or (check is not None and units):
        raise BadInput("name a run, of which units may be chosen, or the uid of a check that was entered by hand")
    found = _check_targets(store, check, action) if run is None else _run_targets(store, run, units, action)
    now_ns = time.time_ns()
    documents = tuple(
        ExclusionEntered(
            run=in_run, t_ns=now_ns, action=action, by=actor.name, identity=actor.identity, reason=reason, unit=unit,
            check=of_check,
        )
        for in_run, unit, of_check in found.named
    )  # fmt: skip
    if documents:
        record_documents(store, documents, role=role, place=Place("local", "entered"), builds_lake=True)
    return Exclusion(found.changed, found.others, documents, _is_in_lake(store, documents))


def _is_in_lake(store: Store, documents: tuple[ExclusionEntered, ...]) -> bool:
    """Whether the lake has the documents: a recorder at work seals them at once, and builds the lake then."""
    if not documents:
        return True
    until = time.monotonic() + _PATIENCE_S
    while True:
        with Catalog(store) as catalog:
            if catalog.rows("from internal.lake_documents where uid = $uid limit 1", {"uid": documents[-1].uid}):
                return True
        if time.monotonic() >= until:
            return False
        time.sleep(0.25)


def _check_targets(store: Store, check: str | None, action: ExclusionAction) -> _Targets:
    with Catalog(store, live=True) as catalog:
        rows = catalog.user_reader(_CHECK, {"uid": check}).read_all().to_pylist()
    if not rows:
        where = f"no check {check!r} was entered into {store.folder}"
        raise NotFound(f"{where}; `gyrofleet audit --unit UNIT --json` has uids")
    (row,) = rows
    unit, is_excluded = str(row["unit"]), row["action"] == ExclusionAction.EXCLUDED
    if is_excluded is (action is ExclusionAction.EXCLUDED):
        return _Targets([], [unit], [])
    return _Targets([unit], [], [(row["run"] or "", unit, check or "")])


def _run_targets(store: Store, run: str, units: tuple[str, ...], action: ExclusionAction) -> _Targets:
    with Catalog(store, live=True) as catalog:
        rows = catalog.user_reader(_UNITS, {"run": run}).read_all().to_pylist()
        tested = {str(row["unit"]): row["reason"] is not None for row in rows}
        if not tested:
            last = catalog.user_reader("select run from runs order by recorded desc limit 8").read_all()
            raise NotFound(
                f"run {run!r} with tested units is not in {store.folder}; the last runs are "
                f"{', '.join(last['run'].to_pylist()) or 'none'}; `gyrofleet runs list` has all"
            )
    if strangers := sorted(set(units) - tested.keys()):
        raise NotFound(f"run {run!r} tested no unit {', '.join(strangers)}; it tested {', '.join(sorted(tested)[:20])}")
    chosen = sorted(set(units)) if units else sorted(tested)
    changed = [unit for unit in chosen if tested[unit] is not (action is ExclusionAction.EXCLUDED)]
    others = [unit for unit in chosen if unit not in changed]
    # a run as a whole, also with units that are tested in it later, where none was chosen
    named: list[str | None] = [*changed] if units else [None] if changed else []
    return _Targets(changed, others, [(run, unit, "") for unit in named])
