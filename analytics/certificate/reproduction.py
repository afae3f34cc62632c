"""Whether a store still gives the results that a certificate states, from the same runs."""

import json
from collections import defaultdict

from analytics.certificate.statement.results import result_of, rounded_to
from analytics.evaluation.selection import Selection, selected
from storage.sql.catalog import Catalog
from stream.errors import NotFound
from stream.events import CertificateIssued

_Key = tuple[str, str, tuple[str, ...]]  # metric, signal, runs


def changed_results(catalog: Catalog, document: CertificateIssued) -> list[str]:
    """What the store gives differently today, to the digits that the certificate states; empty where nothing is.

    Computed anew from the records of the same runs: it differs where records, statements of the station, products or
    the program have changed.
    """
    try:
        rows = selected(catalog, Selection(units=(document.unit,), standards=(document.standard,)))
    except NotFound:
        return [f"the store has no record of {document.unit} any more"]
    now: defaultdict[_Key, list[tuple[float, str]]] = defaultdict(list)
    for row in rows:
        if row["value"] is not None:
            found = result_of(row)
            now[row["metric"], found.signal, found.runs].append((found.value, found.expanded_text))
    changed = []
    for stated in json.loads(document.results):
        for result in stated["results"]:
            given = now[stated["metric"], result["signal"], tuple(result["runs"])]
            digits = result["expanded"]
            was = rounded_to(result["value"], digits), "" if digits is None else rounded_to(digits, digits)
            if was in {(rounded_to(value, digits), expanded) for value, expanded in given}:
                continue
            values = ", ".join(f"{rounded_to(value, digits)} (U = {expanded or '?'})" for value, expanded in given)
            what = f"{stated['name']['en']} {result['signal']}".strip()
            changed.append(f"{what}: stated {was[0]} (U = {was[1] or '?'}), the store gives {values or 'none'}")
    return changed
