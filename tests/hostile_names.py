"""Names that attack what shows or keeps them: refused ones, and ones that are names and stay text everywhere."""

REFUSED = {
    "nothing": "", "a space": "FOG 1", "a tab": "FOG\t1", "a line": "FOG\n1", "a header": "FOG\r\nBcc:x@y",
    "null": "FOG\0", "a path up": "../FOG", "two dots": "..", "a hidden file": ".FOG", "a path": "a/b",
    "a path of Windows": "a\\b", "any key": "**", "one chunk": "*", "a selector": "$*", "a parameter": "a?b",
    "a fragment": "a#b", "a control key": "@ack", "a colour": "\x1b[31mFOG", "a title of the terminal": "\x1b]0;x\x07",
    "C1": "FOG\x9b31m", "delete": "FOG\x7f", "a bell": "FOG\x07", "right to left": "\u202egnp.FOG",
    "an isolate": "FOG\u2066x\u2069", "a mark": "FOG\u200f", "an Arabic mark": "FOG\u061c", "no width": "FOG\u200b1",
    "a joiner": "FOG\u200d1", "a soft hyphen": "FO\u00adG", "a byte-order mark": "\ufeffFOG",
    "a line separator": "FOG\u20281", "a wide space": "FOG\u30001", "half": "FOG\ud800", "no character": "FOG\uffff",
    "private": "FOG\ue000", "tags": "FOG\U000e0041", "too long": "F" * 129,
}  # fmt: skip
"""By what is wrong with each."""

KEPT = (
    "<svg-onload=alert(1)>",
    "</script><b>x".replace("/", ""),
    "a..%2f..%2fetc",
    "O'Brien\";--",
    "');drop-table-x;--",
    "{{7-7}}",
    "{%x%}",
    "{7-7}",
    "=cmd|'calc'!A0",
    "=1+1",
    "+1+1",
    "-1+1",
    '=HYPERLINK("x")',
    "＝1+1",
    "http:x.example",
    '"};alert(1)',
    "a,b;c",
    "%s%n%x",
    "{0.__class__}",
    "&lt;b&gt;",
    "javascript:alert(1)",
    "CON",
    "nul.txt",
    "-rf",
    "--help",
    "~root",
    "`id`",
    "a|b",
    'a"b',
    "零偏-陀螺①",
    "µ-Å-ß",
    "null",
    "NaN",
    "True",
    "1e5",
    "0x1F",
    "a\u0301",
)
"""Names, each of which attacks a spreadsheet, page, shell, template, statement or reader that does not quote it."""

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
"""What a spreadsheet begins a formula with."""
