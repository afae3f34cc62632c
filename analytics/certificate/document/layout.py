"""A certificate as PDF/A-3b, set by typst from `certificate.typ`; missing characters are errors, not holes."""

import datetime as dt
import json
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from analytics.certificate.document.figures import Figure
from analytics.certificate.statement.content import Content, Section
from analytics.certificate.statement.results import Result, ResultRow
from analytics.certificate.statement.words import Language, Words, clause_in_chinese
from analytics.plots.plot_fonts import chinese_font_file
from stream.errors import BadInput

_LATIN = "Libertinus Serif"  # comes with typst
_ATTACHED = "certificate.xml"
_PROPOSED = {"zh": "待批准", "en": "PROPOSED"}
_KINDS = {"results": "results", "operators": "people", "issuer": "people"}
# they stand elsewhere on the page
_LEFT_OUT = {"title", "number"}
_COLUMNS = (
    Words("No.", "序号"), Words("Characteristic", "校准项目"), Words("Result", "校准结果"),
    Words("U", "扩展不确定度 U"), Words("k", "k"), Words("Conditions", "条件"),
)  # fmt: skip


def certificate_pdf(
    content: Content, figures: Sequence[Figure], language: Language, *, attached: bytes | None, mark: str,
    set_at: dt.datetime, is_proposed: bool = False,
) -> bytes:  # fmt: skip
    """The PDF of a certificate, with its digital certificate `attached`.

    `mark` stands small on each page: what made it. The same content at the same moment `set_at` gives the same bytes
    in one process; one that `is_proposed` says so across each page. Raises BadInput if a text cannot be set: a font for
    Chinese is missing, or a character in all fonts.
    """
    import typst

    fonts, folders = _fonts(language)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        source = files("analytics.certificate.document").joinpath("certificate.typ").read_text(encoding="utf-8")
        (folder / "certificate.typ").write_text(source, encoding="utf-8")
        for each in figures:
            (folder / each.name).write_bytes(each.svg)
        if attached is not None:
            (folder / _ATTACHED).write_bytes(attached)
        data = _data(content, figures, language, fonts, mark) | {"attachment": None if attached is None else _ATTACHED}
        if is_proposed:
            data |= {"is_draft": True, "watermark": _PROPOSED["en" if language == "en" else "zh"]}
        (folder / "data.json").write_text(json.dumps(data, ensure_ascii=False), encoding="utf-8")
        known = typst.Fonts(include_system_fonts=False, include_embedded_fonts=True, font_paths=folders)
        try:
            compiler = typst.Compiler(str(folder / "certificate.typ"), root=str(folder), font_paths=known)
            pdf, warnings = compiler.compile_with_warnings(format="pdf", pdf_standards=["a-3b"], timestamp=set_at)
        except typst.TypstError as error:
            raise BadInput(f"the certificate cannot be set: {error.message}; {'; '.join(error.hints)}") from error
    if warnings:
        raise BadInput(f"the certificate cannot be set: {'; '.join(each.message for each in warnings)}")
    assert isinstance(pdf, bytes)
    return pdf


def _fonts(language: Language) -> tuple[list[str], list[str]]:
    if language == "en" and chinese_font_file() is None:
        return [_LATIN], []
    found = chinese_font_file()
    if found is None:
        raise BadInput(
            "a certificate in Chinese needs a Chinese font: install fonts-noto-cjk or fonts-wqy-microhei (Debian), or "
            "give --lang en"
        )
    name, path = found
    return [_LATIN, name], [str(path.parent)]


def _data(
    content: Content, figures: Sequence[Figure], language: Language, fonts: list[str], mark: str
) -> dict[str, Any]:
    facts = content.facts
    shown = ["zh", "en"] if language == "both" else [language]
    heading = {"zh": "校准证书", "en": "Calibration certificate"}
    number = facts.number or {"zh": "草稿", "en": "draft"}[shown[0]]
    line = Words(f"Certificate number {number}", f"证书编号 {number}")
    if facts.supersedes:
        old, why = facts.supersedes, facts.reason
        line = Words(f"{line.en}; replaces {old}: {why}", f"{line.zh}；替代证书 {old}：{why}")
    return {
        "languages": shown,
        "fonts": fonts,
        "title": f"{heading[shown[0]]} {facts.number or facts.evidence.unit}",
        "author": Words.of(facts.order.laboratory.name).en or "-",
        "number": facts.number,
        "number_line": line.zh if shown[0] == "zh" else line.en,
        "heading": [heading[each] for each in shown],
        "header": _words(Words.of(facts.order.laboratory.name)),
        "mark": mark,
        "is_draft": bool(content.missing) or not facts.number,
        "watermark": {"zh": "草稿", "en": "DRAFT"}[shown[0]],
        "missing": [{"clause": _clause(clause, shown[0]), "words": _words(each)} for clause, each in content.missing],
        "words": {
            "missing": _words(Words("Draft: what a certificate still needs", "草稿：尚缺内容")),
            "end": _words(Words("End of the certificate", "证书结束")),
        },
        "columns": [_words(each) for each in _COLUMNS],
        "rows": [line for row in facts.rows for line in _rows(row)],
        "sections": [_section(each, shown[0]) for each in content.sections if each.item.filled_by not in _LEFT_OUT],
        "figures": [{"file": each.name, "caption": _words(each.caption)} for each in figures],
    }


def _clause(clause: str, language: str) -> str:
    return clause_in_chinese(clause) if language == "zh" else clause


def _section(section: Section, language: str) -> dict[str, Any]:
    item = section.item
    return {
        "clause": _clause(item.clause, language),
        "kind": _KINDS.get(item.filled_by, ""),
        "title": _words(Words(item.en, item.zh)),
        "lines": [{"label": _words(each.label), "text": _words(each.text)} for each in section.lines],
    }


def _rows(row: ResultRow) -> list[dict[str, Any]]:
    head = {"number": str(row.number), "name": _words(row.name), "clause": row.clause}
    if not row.results:
        text = Words("not calibrated", "未校准")
        return [head | {"value": "—", "expanded": "", "k": "", "conditions": _words(text)}]
    empty = {"number": "", "name": _words(Words("", "")), "clause": ""}
    many = len({each.signal for each in row.results}) > 1
    return [(empty if at else head) | _cells(each, many) for at, each in enumerate(row.results)]


def _cells(result: Result, named: bool) -> dict[str, Any]:
    en, zh = result.conditions.en, result.conditions.zh
    if named:
        en, zh = f"{result.signal}; {en}".strip("; "), f"{result.signal}；{zh}".strip("；")
    return {
        "value": f"{result.value_text} {result.unit}".strip(),
        "expanded": f"{result.expanded_text} {result.unit}".strip() if result.expanded_text else "",
        "k": "" if result.k is None else f"{result.k:.3g}",
        "conditions": {"en": en, "zh": zh},
    }


def _words(words: Words) -> dict[str, str]:
    return {"en": words.en, "zh": words.zh}
