"""One self-contained HTML page: its style, its small script and the pieces it is put together of.

Nothing on the page is fetched: pictures are data URLs, fonts are the system's. Text that comes
from outside is escaped here and nowhere else.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Sequence

_STYLE = """
:root{color-scheme:light dark;--paper:#f6f7f9;--card:#fff;--ink:#1d2228;--soft:#5d6773;
--line:#e0e4e9;--good:#0b7a4b;--goodbg:#e2f5ec;--warn:#8f5400;--warnbg:#fff1d9;--bad:#b00034;
--badbg:#fde6ec;--code:#eef1f4}
@media(prefers-color-scheme:dark){:root{--paper:#14171b;--card:#1d2228;--ink:#e8ebef;
--soft:#9aa5b1;
--line:#323a43;--good:#5fd3a0;--goodbg:#12382a;--warn:#f2b457;--warnbg:#3b2c10;--bad:#ff7d9c;
--badbg:#431522;--code:#262d35}}
*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,-apple-system,
"Segoe UI",
Roboto,"Noto Sans","DejaVu Sans",sans-serif}
main{max-width:1120px;margin:0 auto;padding:28px 20px 60px}
.kicker{color:var(--soft);font-size:.85rem;letter-spacing:.04em;text-transform:uppercase;
margin:0 0 10px}
h1{font-size:1.85rem;line-height:1.25;margin:0;text-wrap:balance}
h2{font-size:1.25rem;margin:44px 0 12px}h3{font-size:1rem;margin:22px 0 8px}
p{margin:8px 0}.soft{color:var(--soft)}
.verdict{border-radius:14px;padding:22px 26px;border-left:8px solid}
.verdict.good{background:var(--goodbg);border-color:var(--good)}
.verdict.warn{background:var(--warnbg);border-color:var(--warn)}
.verdict.bad{background:var(--badbg);border-color:var(--bad)}
.verdict p{max-width:75ch}
.card{background:var(--card);border:1px solid var(--line);border-radius:14px;padding:20px 22px;
margin:14px 0}
.tiles{display:flex;flex-wrap:wrap;gap:12px;margin:16px 0 4px}
.tile{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:10px 16px;
min-width:104px}
.tile b{display:block;font-size:1.3rem;font-variant-numeric:tabular-nums;white-space:nowrap}
.tile span{color:var(--soft);font-size:.82rem}
.pair{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(430px,100%),1fr));gap:16px}
.pair .card{margin:0}
figure{margin:12px 0 4px}figure button{display:block;width:100%;padding:10px;
border:1px solid var(--line);
border-radius:10px;background:#fff;cursor:zoom-in}
figure img{display:block;max-width:100%;max-height:640px;margin:0 auto}
figcaption{color:var(--soft);font-size:.88rem;margin-top:6px}
.scroll{overflow-x:auto}
table{border-collapse:collapse;min-width:60%;font-size:.93rem}
th{text-align:left;color:var(--soft);font-weight:600;font-size:.82rem}
th,td{padding:6px 10px;border-bottom:1px solid var(--line);vertical-align:top}
th:first-child,td:first-child{padding-left:0;white-space:nowrap}
td{font-variant-numeric:tabular-nums}th.num,td.num{text-align:right;white-space:nowrap}
.pill{display:inline-block;border-radius:99px;padding:1px 11px;font-size:.85rem;font-weight:600;
white-space:nowrap}
.pill.good{background:var(--goodbg);color:var(--good)}.pill.warn{background:var(--warnbg);
color:var(--warn)}
.pill.bad{background:var(--badbg);color:var(--bad)}
.swatch{display:inline-block;width:.85em;height:.85em;border-radius:3px;margin-right:.5em;
vertical-align:-1px}
details{margin:10px 0}summary{cursor:pointer;color:var(--soft)}
pre{background:var(--code);border-radius:8px;padding:12px 14px;overflow-x:auto;font-size:.85rem}
dialog{border:0;padding:0;width:100vw;height:100vh;max-width:none;max-height:none;background:#fff;
overflow:hidden}
dialog img{position:absolute;left:0;top:0;transform-origin:0 0;cursor:grab;user-select:none}
dialog p{position:absolute;right:16px;top:8px;color:#5d6773;font-size:.85rem}
@media print{body{background:#fff}.card,.verdict{break-inside:avoid}}
"""

_SCRIPT = """
(()=>{const d=document.querySelector('dialog'),i=d.querySelector('img');let k=1,x=0,y=0,from=null;
const show=()=>i.style.transform=`translate(${x}px,${y}px) scale(${k})`;
document.querySelectorAll('figure button').forEach(b=>b.onclick=()=>{i.src=b.firstElementChild.src;
i.alt=b.firstElementChild.alt;d.showModal();k=Math.min(innerWidth/i.naturalWidth,innerHeight/i.naturalHeight);
x=(innerWidth-k*i.naturalWidth)/2;y=(innerHeight-k*i.naturalHeight)/2;show()});
d.onwheel=e=>{e.preventDefault();const f=Math.exp(-e.deltaY/400);x=e.clientX-f*(e.clientX-x);
y=e.clientY-f*(e.clientY-y);k*=f;show()};
i.onpointerdown=e=>{e.preventDefault();from=[e.clientX-x,e.clientY-y];i.setPointerCapture(e.pointerId)};
i.onpointermove=e=>{if(from){x=e.clientX-from[0];y=e.clientY-from[1];show()}};
i.onpointerup=()=>from=null;d.onclick=e=>{if(e.target===d)d.close()}})();
"""


def text(value: object) -> str:
    """Return a value as text that is safe in HTML.

    Examples
    --------
    >>> text("a < b")
    'a &lt; b'
    """
    return html.escape(str(value))


def number(value: float, digits: int, unit: str = "") -> str:
    """Return a number with a true minus sign and its unit.

    Examples
    --------
    >>> number(-1.25, 1, "m")
    '−1.2\\xa0m'
    """
    digits_text = f"{value:.{digits}f}"
    if float(digits_text) == 0:
        digits_text = digits_text.lstrip("-")
    return digits_text.replace("-", "−") + (f"\u00a0{unit}" if unit else "")


def counted(count: int, word: str) -> str:
    """Return a number with the word for what it counts.

    Examples
    --------
    >>> counted(1, "pair"), counted(2, "pair")
    ('1 pair', '2 pairs')
    """
    return f"{count} {word}" + ("" if count == 1 else "s")


def pill(kind: str, label: str) -> str:
    """Return a coloured label; `kind` is "good", "warn" or "bad"."""
    return f'<span class="pill {kind}">{text(label)}</span>'


def swatch(colour: str) -> str:
    """Return a small square of a colour."""
    return f'<span class="swatch" style="background:{colour}"></span>'


def tiles(values: Iterable[tuple[str, str]]) -> str:
    """Return large numbers side by side: (value, what it is)."""
    body = "".join(f'<div class="tile"><b>{v}</b><span>{text(k)}</span></div>' for v, k in values)
    return f'<div class="tiles">{body}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numeric: str = "") -> str:
    """Return a table; `rows` hold HTML, `numeric` has an "n" for every column of numbers."""
    kinds = [' class="num"' if k == "n" else "" for k in numeric.ljust(len(head))]
    top = "".join(f"<th{k}>{text(h)}</th>" for k, h in zip(kinds, head, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td{k}>{c}</td>" for k, c in zip(kinds, row, strict=True)) + "</tr>\n"
        for row in rows
    )
    return f'<div class="scroll"><table><tr>{top}</tr>\n{body}</table></div>'


def picture(png: bytes | None, alternative: str, caption: str = "") -> str:
    """Return a picture that opens large on a click, nothing where there is none."""
    if png is None:
        return ""
    data = base64.b64encode(png).decode("ascii")
    note = f"<figcaption>{text(caption)}</figcaption>" if caption else ""
    return (
        f'<figure><button type="button" aria-label="enlarge"><img alt="{text(alternative)}" '
        f'src="data:image/png;base64,{data}"></button>{note}</figure>'
    )


def details(summary: str, body: str) -> str:
    """Return a part that opens on a click."""
    return f"<details><summary>{text(summary)}</summary>{body}</details>"


def page(title: str, body: str) -> str:
    """Return the whole page round `body`."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{text(title)}</title><style>{_STYLE}</style></head>\n<body><main>\n{body}\n</main>"
        '<dialog><img alt=""><p>wheel: zoom · drag: move · Esc: close</p></dialog>'
        f"<script>{_SCRIPT}</script></body></html>\n"
    )
