"""A diagnosis on the terminal."""

from collections.abc import Mapping

from analytics.loop.next_test.recommendation import NextTest
from analytics.loop.report.finding_sentences import (
    alternative,
    evidence,
    fleet_rows,
    fleet_sentence,
    separating_test,
    unit_rows,
)
from analytics.loop.report.next_test_rows import afterwards, bounds_sentence, next_test_rows, next_test_sentence
from analytics.loop.report.report_tables import TextTable, absent_rows, achieved, error_rows, gain_rows, noise_rows
from analytics.loop.report.scrutiny_rows import recovery_sentences
from analytics.loop.report.verdict_sentence import verdict_sentence
from analytics.loop.report.wording import Language, Wording
from analytics.loop.unit_diagnosis import UnitDiagnosis, UnitsDiagnosis
from stream.terminal.console import notes, results, styled
from stream.terminal.result_table import ResultTable

_MOST_NAMED = 3


def print_unit(found: UnitDiagnosis, language: Language) -> None:
    """Print the diagnosis of one unit: results on standard output, caveats and notes on standard error."""
    words, diagnosis, console = Wording(language, found.data.runs[0]), found.diagnosis, results()
    for text in diagnosis.losses:
        console.print(f"{words.of('caveat', '局限')}: {words.text(text)}")
    console.print(styled(verdict_sentence(diagnosis, words), "bold"))
    for effect in (*diagnosis.by_size, *diagnosis.unreplicated):
        console.print(f"\n{words.effect(effect)}: {words.coefficient(effect)}")
        for sentence in evidence(effect, diagnosis, words):
            console.print(f"  {sentence}")
        for other in effect.confounded:
            console.print(f"  {words.of('or', '或')} {alternative(other, words)}")
            test = separating_test(other, words)
            console.print(f"     {words.of('separating test', '区分方法')}: {test}")
    if diagnosis.error is not None:
        console.print()
        for table in (error_rows(diagnosis.error, words), gain_rows(diagnosis.error, words)):
            if table.rows:
                console.print(_rich(table))
        if (share := achieved(diagnosis.error, words)) is not None:
            console.print(share)
    for sentence in recovery_sentences(found.recovery or {}, words):
        console.print(sentence)
    if found.left is not None:
        console.print(words.clause(found.left.sentence))
    _print_noise(found, words)
    _print_next_test(found, words)
    _print_remarks({found.unit: found}, words)


def _print_noise(found: UnitDiagnosis, words: Wording) -> None:
    """Noise, and what it hides."""
    console, diagnosis = results(), found.diagnosis
    if diagnosis.noise is not None:
        console.print(_rich(noise_rows(diagnosis, words)))
        source = words.of("source of the declared noise", "已声明噪声的来源")
        console.print(f"{source}: {words.text(found.data.noise_source)}")
    if diagnosis.detection_limits:
        console.print(_rich(absent_rows(diagnosis, words)))


def _print_next_test(found: UnitDiagnosis, words: Wording) -> None:
    if found.next_test is not None:
        _print_plans(found.next_test, words)
    elif found.is_planned:
        results().print(words.of("Next test: nothing is open.", "下一项试验：没有待判别的问题。"))


def _print_plans(asked: NextTest, words: Wording) -> None:
    console = results()
    console.print(f"\n{next_test_sentence(asked, words)}")
    if asked.plans:
        console.print(_rich(next_test_rows(asked, words)))
        console.print(afterwards(asked, words))
    if (bounds := bounds_sentence(asked, words)) is not None:
        console.print(bounds)


def print_units(found: UnitsDiagnosis, language: Language) -> None:
    """Print the diagnoses of several units."""
    words, console = Wording(language, next(iter(found.units.values())).data.runs[0]), results()
    caveat = words.of("caveat", "局限")
    for unit, each in found.units.items():
        for text in each.diagnosis.losses:
            console.print(f"{caveat} ({unit}): {words.text(text)}")
    if found.fleet is not None:
        console.print(styled(fleet_sentence(found.fleet, words), "bold"))
        for name, rows in found.fleet.by_unit.items():
            console.print(_rich(fleet_rows(name, rows, words)))
        if found.next_test is not None:
            _print_plans(found.next_test, words)
        for text in found.fleet.limits:
            notes().print(f"{caveat}: {words.text(text)}", soft_wrap=True)
    console.print(_rich(unit_rows(found, words)))
    for unit, each in found.units.items():
        if each.left is not None:
            console.print(f"{unit}: {words.clause(each.left.sentence)}")
        if each.next_test is not None:
            console.print(f"{unit}: {next_test_sentence(each.next_test, Wording(language, each.data.runs[0]))}")
    _print_remarks(found.units, words)


def _print_remarks(units: Mapping[str, UnitDiagnosis], words: Wording) -> None:
    """Caveats and notes, each once, with its units if there are several; caveats first."""
    owners: dict[tuple[bool, str], list[str]] = {}
    for unit, each in units.items():
        remarks = [(True, words.text(text)) for text in each.diagnosis.limits if text not in each.diagnosis.losses]
        remarks += [(note.is_limit, words.text(note.text)) for note in each.data.notes]
        for remark in dict.fromkeys(remarks):
            owners.setdefault(remark, []).append(unit)
    for (is_caveat, text), of in sorted(owners.items(), key=lambda each: not each[0][0]):
        kind = words.of("caveat", "局限") if is_caveat else words.of("note", "说明")
        if len(units) > 1:
            whose = ", ".join(of) if len(of) <= _MOST_NAMED else words.of(f"{len(of)} units", f"{len(of)}个产品")
            kind += f" ({whose})"
        notes().print(f"{kind}: {text}", soft_wrap=True)


def _rich(table: TextTable) -> ResultTable:
    shown = ResultTable(title=table.title)
    for at, title in enumerate(table.columns):
        shown.add_column(title, justify="right" if table.is_numeric(at) else "left", overflow="fold")
    for row in table.rows:
        shown.add_row(*row)
    return shown
