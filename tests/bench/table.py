"""Every work that users wait for, beside its peer and its bar: ``python tests/bench/table.py [--only WORD] [--json]``.

Each row measures in processes of its own, ours and the peer in turn on the same machine, and says whether the bar
holds. ``--json`` gives a list of ``{"work", "unit", "ours", "peer", "ratio", "bar", "holds"}``: `ratio` is ours by the
peer's, null where there is no peer; `holds` is null where the row could not be measured, and `reason` says why. The
exit code is 1 where a bar does not hold. The peers are installed by the extra ``bench``. All rows take about a quarter
of an hour and 4 GB of disk; ``--list`` names them.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.table_rows import ROWS, Measured, Row, machine


def measured(row: Row) -> dict[str, object]:
    """A row as it is printed."""
    try:
        found = row.measure()
    except Exception as error:  # noqa: BLE001  one row that cannot be measured must not take the others with it
        found = Measured(None, None, None, f"{type(error).__name__}: {error}")
    ratio = None if found.ours is None or found.peer is None else found.ours / found.peer
    answer: dict[str, object] = {
        "work": row.work, "unit": row.unit, "ours": found.ours, "peer": found.peer, "ratio": ratio, "bar": row.bar,
        "holds": found.holds,
    }  # fmt: skip
    return answer | ({"reason": found.reason} if found.reason else {})


def line(row: dict[str, object]) -> str:
    """A row for people."""
    ours, peer, ratio = (f"{each:.3g}" if isinstance(each, float) else "-" for each in map(row.get, SHOWN))
    holds = "not measured" if row["holds"] is None else "holds" if row["holds"] else "MISSED"
    return f"{row['work']:58.58} {ours:>8} {peer:>8} {ratio:>6} {row['unit']:12.12} {row['bar']:34.34} {holds}"


SHOWN = ("ours", "peer", "ratio")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], help="rows whose work contains this; several")
    parser.add_argument("--list", action="store_true", help="name the rows and their bars")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    wanted = [row for row in ROWS if not asked.only or any(word in row.work for word in asked.only)]
    if not wanted:
        sys.exit(f"no row with {' or '.join(asked.only)}; --list names them")
    if asked.list:
        for row in wanted:
            print(f"{row.work:60} {row.bar} {row.unit}")
        return
    print(machine(), file=sys.stderr)
    rows = []
    for row in wanted:
        rows.append(measured(row))
        print(line(rows[-1]), file=sys.stderr if asked.json else sys.stdout, flush=True)
    if asked.json:
        print(json.dumps(rows, indent=1))
    sys.exit(0 if all(row["holds"] for row in rows) else 1)


if __name__ == "__main__":
    main()
