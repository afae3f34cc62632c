"""What a certificate states, item by item of its standard, and what is missing for it."""

import datetime as dt
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from analytics.certificate.statement.conformity import Conformity
from analytics.certificate.statement.departures import compensation_of, departures, left_out, not_stated, states_any
from analytics.certificate.statement.evidence import Evidence, Span
from analytics.certificate.statement.order import Order, Text
from analytics.certificate.statement.references import Reference, contradictions
from analytics.certificate.statement.results import ResultRow
from analytics.certificate.statement.standards import Item, Standard
from analytics.certificate.statement.validity import later
from analytics.certificate.statement.words import Words
from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.type_b import COVERAGE

_SAME = "/"
_STATED_WITHOUT_U = frozenset({"range"})  # the largest of the rates that were tested, and no estimate


class Facts(NamedTuple):
    """All that a certificate is made of."""

    standard: Standard
    order: Order
    evidence: Evidence
    rows: tuple[ResultRow, ...]
    number: str  # empty in a draft
    issued: dt.date  # at the station of the last run
    supersedes: str = ""  # number of the certificate that it replaces, and why
    reason: str = ""
    conformity: Conformity | None = None  # where a statement was ordered

    @property
    def references(self) -> tuple[Reference, ...]:
        """Measurement standards: those that the runs state, and those of the order."""
        return (*self.evidence.references, *(Reference.of_table(each) for each in self.order.reference))


class Line(NamedTuple):
    """A line of a section: label and text; a label may be empty."""

    label: Words
    text: Words


class Section(msgspec.Struct, frozen=True, kw_only=True):
    """One item of the standard: its lines, and what is missing for it."""

    item: Item
    lines: tuple[Line, ...]
    missing: tuple[Words, ...] = ()


class Content(msgspec.Struct, frozen=True, kw_only=True):
    """The whole content."""

    facts: Facts
    sections: tuple[Section, ...]

    @property
    def missing(self) -> tuple[tuple[str, Words], ...]:
        """What is missing, each with the clause that asks for it."""
        return tuple((section.item.clause, each) for section in self.sections for each in section.missing)

    def section(self, filled_by: str) -> Section | None:
        """The section of a name, if the standard has it."""
        return next((each for each in self.sections if each.item.filled_by == filled_by), None)


def content_of(facts: Facts) -> Content:
    """The content of a certificate: one section for each item of its standard."""
    sections = []
    for item in facts.standard.items:
        if item.filled_by == "conformity" and facts.conformity is None:
            continue
        lines, missing = FILLED_BY[item.filled_by](facts)
        sections.append(Section(item=item, lines=tuple(lines), missing=tuple(missing)))
    return Content(facts=facts, sections=tuple(sections))


_Filled = tuple[Sequence[Line], Sequence[Words]]


def _required(*lines: tuple[str, str, Text]) -> _Filled:
    """Lines whose text somebody has to give."""
    found = [Line(Words(en, zh), Words.of(given)) for en, zh, given in lines]
    missing = [
        Words(f"{each.label.en.lower()} is not given", f"未给出{each.label.zh}") for each in found if not each.text
    ]
    return [each for each in found if each.text], missing


def _title(_: Facts) -> _Filled:
    return [Line(Words("Title", "标题"), Words("Calibration certificate", "校准证书"))], []


def _laboratory(facts: Facts) -> _Filled:
    table = facts.order.laboratory
    lines, missing = _required(
        ("Name of the laboratory", "实验室名称", table.name), ("Address of the laboratory", "实验室地址", table.address)
    )
    accredited = Words.of(table.accreditation)
    return [*lines, *([Line(Words("Accreditation", "认可"), accredited)] if accredited else [])], missing


def _place(facts: Facts) -> _Filled:
    place, table = Words.of(facts.order.laboratory.place), facts.order.laboratory
    stations = sorted({f"{run.site} {_SAME} {run.station}" for run in facts.evidence.runs})
    at = Words(", ".join(stations), "、".join(stations))
    where = place or (Words("at the address of the laboratory", "实验室地址") if Words.of(table.address) else None)
    if where is None:
        return [], [Words("the place of calibration is not given", "未给出校准地点")]
    return [Line(Words("Place of calibration", "校准地点"), where), Line(Words("Station", "试验台"), at)], []


def _number(facts: Facts) -> _Filled:
    text = Words(facts.number, facts.number) if facts.number else Words("draft, not issued", "草稿，未签发")
    return [Line(Words("Certificate number", "证书编号"), text)], []


def _customer(facts: Facts) -> _Filled:
    table = facts.order.customer
    return _required(
        ("Name of the customer", "客户名称", table.name), ("Address of the customer", "客户地址", table.address)
    )


def _device(facts: Facts) -> _Filled:
    table, evidence = facts.order.device, facts.evidence
    lines, missing = _required(
        ("Description", "名称", table.description or facts.standard.device),
        ("Model", "型号规格", table.model or evidence.product or ""),
        ("Serial number", "编号", evidence.unit),
    )
    more = [Line(Words("Manufacturer", "制造厂"), Words.of(table.manufacturer))] if table.manufacturer else []
    firmware = [Line(Words("Firmware", "固件版本"), Words.of(evidence.firmware))] if evidence.firmware else []
    return [*lines[:1], *more, *lines[1:], *firmware], missing


def _maker_and_model(facts: Facts) -> _Filled:
    lines, missing = _device(facts)
    _, no_maker = _required(("Manufacturer", "制造厂", facts.order.device.manufacturer))
    return lines, [*missing, *no_maker]


def _dates(facts: Facts) -> _Filled:
    days, received = facts.evidence.days, facts.order.device.received
    lines = [] if received is None else [_dated("Received", "接收日期", received)]
    if days is None:
        return lines, [Words("the date of a run is not known; import it with --start", "试验日期未知")]
    first, last = days
    missing = []
    if received is not None and received > first:
        en = f"it was received on {received}, after the first run of {first}: correct the date"
        missing.append(Words(en, f"接收日期 {received} 晚于首次试验 {first}：请更正"))
    if last > facts.issued:
        en = f"the calibration ended on {last}, which is after today, {facts.issued}: correct --start or the clock"
        missing.append(Words(en, f"校准结束日期 {last} 晚于今日 {facts.issued}：请更正--start或系统时钟"))
    text = Words.of(first.isoformat()) if first == last else Words(f"{first} - {last}", f"{first} 至 {last}")
    lines.append(Line(Words("Calibrated", "校准日期"), text))
    lines.append(_dated("Issued", "签发日期", facts.issued))
    if facts.order.valid_months is not None:
        lines.append(_dated("Recommended next calibration", "建议复校日期", later(last, facts.order.valid_months)))
    return lines, missing


def _received_and_dates(facts: Facts) -> _Filled:
    lines, missing = _dates(facts)
    no_day = [] if facts.order.device.received else [Words("the date of receipt is not given", "未给出接收日期")]
    return lines, [*missing, *no_day]


def _sampling(facts: Facts) -> _Filled:
    none = Words("The calibrated item is no sample of a lot.", "被校对象不是抽样样品。")
    return [Line(Words("Sampling", "抽样"), Words.of(facts.order.device.sampling) or none)], []


def _specification(facts: Facts) -> _Filled:
    one = facts.standard
    text = Words(f"{one.code} {one.title.en}", f"{one.code}《{one.title.zh}》")
    return [Line(Words("Specification", "技术规范"), text)], []


def _references(facts: Facts) -> _Filled:
    last_day = None if facts.evidence.days is None else facts.evidence.days[1]
    missing = [what for each in facts.references for what in each.missing(last_day)]
    missing += contradictions(facts.references)
    if not facts.references:
        missing.append(Words("no measurement standard is named", "未给出所用测量标准"))
    lines = [Line(each.name, each.text) for each in facts.references]
    if traceability := Words.of(facts.order.traceability):
        lines.append(Line(Words("Traceability", "溯源性"), traceability))
    elif untraced := [each for each in facts.references if not each.traceable_to]:
        en, zh = ", ".join(each.name.en for each in untraced), "、".join(each.name.zh for each in untraced)
        missing.append(
            Words(
                f"traceability is not stated of {en}: traceable_to of the standard, or traceability of the order",
                f"未说明溯源性：{zh}（station文件的traceable_to，或委托信息的traceability）",
            )
        )
    return lines, missing


def _environment(facts: Facts) -> _Filled:
    asked, given, one = facts.order.environment, facts.evidence, facts.standard
    lines: list[Line] = []
    missing: list[Words] = []
    for name, en, zh, symbol, recorded, stated, wanted in (
        ("temperature_deg_c", "Temperature", "温度", "°C", given.temperature, asked.temperature_deg_c,
         one.temperature_deg_c),
        ("relative_humidity_percent", "Relative humidity", "相对湿度", "%", given.relative_humidity,
         asked.relative_humidity_percent, one.relative_humidity_percent),
    ):  # fmt: skip
        span = recorded.beside(stated)
        if span is None:
            missing.append(Words(f"{en.lower()} is neither recorded nor given", f"{zh}未记录也未给出"))
            continue
        if not recorded.is_whole(len(given.runs)) and stated is None:
            part, whole = recorded.runs, len(given.runs)
            missing.append(
                Words(
                    f"{en.lower()} is recorded in {part} of {whole} runs: give environment.{name} for the others",
                    f"{whole}次试验中仅{part}次记录了{zh}：请给出其余试验的environment.{name}",
                )
            )
        lines.append(Line(Words(en, zh), _spanned(span, symbol, is_recorded=span == recorded.span)))
        if not wanted[0] <= span[0] <= span[1] <= wanted[1] and not states_any(facts.order.deviations):
            between = f"{wanted[0]:g} - {wanted[1]:g} {symbol}"
            missing.append(
                Words(f"{en.lower()} was outside {between}: state the deviation", f"{zh}超出 {between}：须说明偏离")
            )
    if (largest := one.temperature_change_deg_c) is not None:
        more, lacking = _change(facts, largest)
        lines += more
        missing += lacking
    if other := Words.of(asked.other):
        lines.append(Line(Words("Other", "其他"), other))
    return lines, missing


def _change(facts: Facts, largest: float) -> _Filled:
    """The change of temperature during a measurement, which a span within the largest change allowed states as well."""
    change = facts.order.environment.temperature_change_deg_c
    span = facts.evidence.temperature.beside(facts.order.environment.temperature_deg_c)
    if change is None:
        if span is None or span[1] - span[0] <= largest:
            return [], []
        en = f"the change of temperature during a measurement, at most {largest:g} °C, is not given: "
        zh = f"未给出校准过程中的温度波动量（不得超过 {largest:g} °C）："
        name = "environment.temperature_change_deg_c"
        return [], [Words(en + name, zh + name)]
    lines = [Line(Words("Change during a measurement", "校准过程中温度波动量"), Words.of(f"{change:g} °C"))]
    if change <= largest:
        return lines, []
    return lines, [Words(f"temperature changed by more than {largest:g} °C", f"温度波动量超过 {largest:g} °C")]


def _spanned(span: Span, symbol: str, *, is_recorded: bool) -> Words:
    least, most = (f"{each:.1f}" for each in span)
    text = f"{least} {symbol}" if least == most else f"({least} - {most}) {symbol}"
    return Words(f"{text}, recorded" if is_recorded else text, f"{text}，实测记录" if is_recorded else text)


def _results(facts: Facts) -> _Filled:
    missing: list[Words] = []
    ordered = set(facts.order.items)
    for row in facts.rows:
        if row.metric in ordered and not row.results:
            missing.append(Words(f"{row.name.en}: {row.reason}", f"{row.name.zh}：{in_chinese(row.reason or '')}"))
        if row.metric in _STATED_WITHOUT_U:
            continue
        reasons = dict.fromkeys(each.why_no_u for each in row.results if each.expanded is None)
        en, zh = f"{row.name.en}: no expanded uncertainty", f"{row.name.zh}：无扩展不确定度"
        missing += [Words(f"{en}: {why}", f"{zh}：{in_chinese(why)}") for why in reasons]
    if not any(row.results for row in facts.rows):
        missing.append(Words("there is no result", "没有校准结果"))
    simulated = [each.run for each in facts.evidence.runs if each.simulated]
    missing += [Words(f"run {run} is simulated", f"试验 {run} 为仿真数据") for run in simulated]
    text = Words(
        f"U is the expanded uncertainty with coverage factor k for a coverage probability of {COVERAGE:.2%}, evaluated "
        "by JJF 1059.1 (JCGM 100); k is above 2 where the effective degrees of freedom are few.",
        f"U 为扩展不确定度，k 为包含因子，包含概率 p = {COVERAGE:.2%}，按 JJF 1059.1 评定；有效自由度较小时 k 大于 2。",
    )
    return [Line(Words("", ""), text), Line(Words("", ""), compensation_of(facts.rows))], missing


def _conformity(facts: Facts) -> _Filled:
    found = facts.conformity
    assert found is not None
    name = found.specification
    if not found.judged:
        en = f"no result is judged by the specification {name}: `gyrofleet verdicts --unit {facts.evidence.unit}`"
        return [], [Words(en, f"没有按规范 {name} 判定的结果")]
    lines = [
        Line(Words("Specification", "规范"), Words.of(f"{name}, {found.revisions}")),
        *(Line(Words("Decision rule", "判定规则"), each) for each in found.rules),
        *(Line(each.label, each.text) for each in found.judged),
    ]
    if found.left:
        lines.append(Line(Words("Not judged here", "未在此判定"), found.not_judged))
    return lines, []


def _deviations(facts: Facts) -> _Filled:
    lines, missing = _required(("Deviations", "偏离", facts.order.deviations))
    more, not_given = _departures(facts)  # begins with the same line
    return [*lines, *more[len(lines) :]], [*missing, *(not_given if lines else [])]


def _departures(facts: Facts) -> _Filled:
    """Deviations where the standard does not ask for them: those that are stated, and those that were found."""
    found, stated = departures(facts.rows), Words.of(facts.order.deviations)
    lines = [Line(Words("Deviations", "偏离"), stated or Words("not stated", "未给出"))]
    lines += [Line(Words("Found in the records", "记录中的偏离"), each) for each in found]
    excluded = left_out(facts.evidence.excluded, facts.order.device.received)
    lines += [Line(Words("Left out", "未参与评定的试验"), each) for each in excluded]
    if remarks := Words.of(facts.order.remarks):
        lines.append(Line(Words("Remarks", "备注"), remarks))
    return lines, not_stated(facts.order.deviations, found)


def _issuer(facts: Facts) -> _Filled:
    people = facts.order.people
    lines, missing = _required(
        ("Issued by", "签发人", people.issued_by), ("Position of the issuer", "职务", people.issued_as)
    )
    return [*lines, _dated("Issued", "签发日期", facts.issued)], missing


def _operators(facts: Facts) -> _Filled:
    people = facts.order.people
    return _required(("Calibrated by", "校准员", people.calibrated_by), ("Checked by", "核验员", people.checked_by))


def _seal(_: Facts) -> _Filled:
    return [Line(Words("Seal for calibration", "校准专用章"), Words("(place of the seal)", "（盖章处）"))], []


def _only_this_item(_: Facts) -> _Filled:
    text = Words("The results hold for the calibrated item only.", "校准结果仅对被校对象有效。")
    return [Line(Words("", ""), text)], []


def _no_partial_copy(_: Facts) -> _Filled:
    text = Words(
        "This certificate may not be copied in part without the written approval of the laboratory.",
        "未经实验室书面批准，不准部分复制本证书。",
    )
    return [Line(Words("", ""), text)], []


def _dated(en: str, zh: str, day: dt.date) -> Line:
    return Line(Words(en, zh), Words.of(day.isoformat()))


# by the name in `standards.toml`
FILLED_BY: dict[str, Callable[[Facts], _Filled]] = {
    "title": _title, "laboratory": _laboratory, "place": _place, "number": _number, "seal": _seal,
    "customer": _customer, "device": _device, "maker_and_model": _maker_and_model, "dates": _dates,
    "received_and_dates": _received_and_dates, "sampling": _sampling, "specification": _specification,
    "references": _references, "environment": _environment, "results": _results, "conformity": _conformity,
    "deviations": _deviations, "departures": _departures, "issuer": _issuer, "operators": _operators,
    "only_this_item": _only_this_item, "no_partial_copy": _no_partial_copy,
}  # fmt: skip
