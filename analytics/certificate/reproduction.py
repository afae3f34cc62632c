"""Whether a store still gives the results and the conformity that a certificate states, from the same runs."""

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from analytics.certificate.document.digital import conformity_stated
from analytics.certificate.record import kept_file
from analytics.certificate.record import sha256_of as digest_of
from analytics.certificate.statement.conformity import Judged, read_conformity
from analytics.certificate.statement.results import result_of, result_rows, rounded_to
from analytics.evaluation.inner_page import inner_page
from analytics.evaluation.selection import Selection, selected
from storage.manifests.log import read_log_manifest
from storage.segments.disk import sha256_of
from storage.sql.catalog import Catalog
from storage.sql.reading import excluded_runs
from stream.errors import NotFound, StoreError
from stream.events import CertificateIssued

_WITHDRAWN = """
select withdrawn from internal.withdrawn_revisions where specification = $specification and revision = $revision
"""
_FILES = "select distinct filename from internal.lake_channel_parts where list_contains($runs, run)"
_Key = tuple[str, str, tuple[str, ...]]  # metric, signal, runs
_Now = dict[str, list[tuple[float, str]]]  # values with their U, by conditions


def check_records(catalog: Catalog, runs: Sequence[str]) -> None:
    """Raise a StoreError unless the files that have some runs, of the log and of the lake, are what was recorded."""
    rows = catalog.rows(_FILES, {"runs": sorted(runs)})
    folders = {Path(name).parent.name for (name,) in rows}
    entries = read_log_manifest(catalog.store).entries
    segments = {each for part in catalog.parts if part.name in folders for each in part.sources}
    for name in sorted(segments):
        path, entry = catalog.store.log / f"{name}.mcap", entries.get(f"{name}.mcap")
        if entry is not None and path.exists() and sha256_of(path) != entry.sha256:
            raise StoreError(
                f"{path} is not what was recorded: results of it certify nothing; `gyrofleet verify` names what is "
                "damaged, restore the segment from a copy"
            )
    for part in catalog.parts:
        for name, file in part.files.items() if part.name in folders else ():
            path = catalog.store.lake / part.name / name
            if sha256_of(path) != file.sha256:
                raise StoreError(
                    f"{path} is not the file that was built from the log: results of it certify nothing; "
                    "`gyrofleet verify` names what is damaged, `gyrofleet recover` builds it again"
                )


def changed_results(catalog: Catalog, document: CertificateIssued) -> list[str]:
    """What the store gives differently today, to the digits that the certificate states; empty where nothing is.

    Of a catalogue that uses nothing kept, computed again from the records of the same runs: it differs where records,
    statements of the station, products or the program have changed.
    """
    try:
        check_records(catalog, document.runs)
    except StoreError as error:
        return [str(error)]
    excluded = [
        f"it rests on run {run}, which is excluded from evaluation: {reason}"
        for run, reason in excluded_runs(catalog, document.unit).items()
        if run in document.runs
    ]
    try:
        rows = selected(catalog, Selection(units=(document.unit,), standards=(document.standard,)))
    except NotFound:
        return excluded or [f"the store has no record of {document.unit} any more"]
    now: defaultdict[_Key, _Now] = defaultdict(dict)
    for row in rows:
        if row["value"] is not None:
            found = result_of(row)
            of_key = now[row["metric"], found.signal, found.runs]
            of_key.setdefault(found.conditions.en, []).append((found.value, found.expanded_text))
    changed = excluded
    for stated in json.loads(document.results):
        for result in stated["results"]:
            of_key = now[stated["metric"], result["signal"], tuple(result["runs"])]
            conditions = result["conditions"]["en"]
            # conditions that have changed, as a temperature, leave all that is of the same runs
            given = of_key.get(conditions) or [each for values in of_key.values() for each in values]
            digits = result["expanded"]
            was = rounded_to(result["value"], digits), "" if digits is None else rounded_to(digits, digits)
            if was in {(rounded_to(value, digits), expanded) for value, expanded in given}:
                continue
            values = ", ".join(f"{rounded_to(value, digits)} (U = {expanded or '?'})" for value, expanded in given)
            what = f"{stated['name']['en']} {result['signal']}".strip() + (f" ({conditions})" if conditions else "")
            changed.append(f"{what}: stated {was[0]} (U = {was[1] or '?'}), the store gives {values or 'none'}")
    return changed


def changed_statements(catalog: Catalog, document: CertificateIssued, digital: bytes | None = None) -> list[str]:
    """What a certificate states of conformity and the store judges differently today, or by a revision withdrawn since.

    The statements are those of its digital form, by default of the one that the store keeps.
    """
    if digital is None:
        path = kept_file(catalog.store, document.number, ".xml")
        digital = path.read_bytes() if path.is_file() else b""
    if digest_of(digital) != document.digital_sha256:
        return ["its digital form is not in the store: whether its statements of conformity hold is not known"]
    stated = conformity_stated(digital)
    rows = result_rows(inner_page(catalog, document.unit, document.standard)) if stated else ()
    now: dict[str, dict[str, Judged]] = {}
    changed: list[str] = []
    for specification, revision, text, status in stated:
        if specification not in now:
            found = read_conformity(catalog, document.unit, specification, rows).judged
            now[specification] = {f"{each.label.en}: ": each for each in found}
        withdrawn = catalog.rows(_WITHDRAWN, {"specification": specification, "revision": revision})
        changed += [f"conformity is stated by {specification}-{revision}; {each}" for (each,) in withdrawn]
        judged = next((each for label, each in now[specification].items() if text.startswith(label)), None)
        if judged is None:
            changed.append(f"{text}, as stated by revision {revision}; no revision of {specification} judges it today")
        elif judged.status != status:
            today = f"{judged.text.en}, by revision {judged.revision}"
            changed.append(f"{text}, as stated by revision {revision}; the store gives {today}")
    return list(dict.fromkeys(changed))
