"""Reference pages written from the program itself: tables, metrics, effects, procedures."""

import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path


def write_reference(folder: Path) -> None:
    """Write the pages; a page that is as it was is left alone, so that it is not read again."""
    folder.mkdir(exist_ok=True)
    for name, text in {
        "tables.md": _tables(),
        "metrics.md": _metrics(),
        "effects.md": _effects(),
        "procedures.md": _procedures(),
    }.items():
        page = folder / name
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def _tables() -> str:
    from storage.sql.catalog import Catalog
    from storage.sql.tables import columns_of, described_tables, examples
    from storage.store import Store

    parts = ["# Tables in SQL", "What `gyrofleet sql` and `open_store(...).sql(...)` can ask."]
    with tempfile.TemporaryDirectory() as folder, Catalog(Store.create(Path(folder) / "store")) as catalog:
        for table in described_tables(catalog):
            rows = [
                (f"`{row['column']}`", f"`{row['type']}`", row["what"])
                for row in columns_of(catalog, str(table["table"]))
            ]
            parts += [f"## {table['table']}", str(table["what"]), _table(("column", "type", "what it holds"), rows)]
    parts.append("## Examples")
    parts += [f"{question}\n\n```sql\n{statement}\n```" for question, statement in examples().items()]
    return _page(parts)


def _metrics() -> str:
    from analytics.metric_registry.registry import metrics

    headers = [metric.header for metric in metrics().values()]
    rows = [
        (
            f"`{each.id}`",
            each.en,
            each.zh,
            each.unit,
            "; ".join(f"{s.standard} {s.clause}" for s in each.sources),
            each.needs,
            ", ".join(f"`{name}`" for name in each.parameters),
        )
        for each in headers
    ]
    titles = ("id", "name", "名称", "unit", "clause", "needs", "parameters")
    return _page(["# Metrics", f"{len(rows)} metrics; `gyrofleet metrics` computes them.", _table(titles, rows)])


def _effects() -> str:
    from analytics.loop.effects.registry import effects

    rows = [
        (f"`{name}`", each.en, each.zh, ", ".join(f"`{channel}`" for channel in each.needs), each.cause)
        for name, each in effects().items()
    ]
    about = f"{len(rows)} effects that `gyrofleet diagnose` tries, besides those of other channels."
    return _page(["# Effects", about, _table(("id", "name", "名称", "channels", "cause"), rows)])


def _procedures() -> str:
    from ingest.procedures.file import read_procedure, ready_names

    files = [read_procedure(name)[0] for name in ready_names()]
    rows = [(f"`{each.name}`", each.names.en, each.names.zh, "; ".join(each.source)) for each in files]
    about = f"{len(rows)} procedures that `gyrofleet run` carries out; `gyrofleet procedure show` has their steps."
    return _page(["# Procedures", about, _table(("id", "name", "名称", "source"), rows)])


def _table(titles: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(str(cell).replace('|', chr(92) + '|') for cell in line)} |" for line in lines)


def _page(parts: Iterable[str]) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"
