"""The page around a report: one HTML file, everything in it, for the screen and for paper."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape

import scpjax

STYLE = """
:root { --ink: #1f2428; --soft: #59636e; --line: #dfe3e8; --paper: #ffffff; --wash: #f6f7f9;
  --before: #d55e00; --after: #0072b2; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 1rem/1.55 Inter, "Source Sans 3",
  "Segoe UI", Roboto, "Helvetica Neue", Arial, "DejaVu Sans", sans-serif;
  font-variant-numeric: tabular-nums; }
main { max-width: 54rem; margin: 0 auto; padding: 2.6rem 1.4rem 4rem; }
h1 { font: 600 1.72rem/1.28 Charter, "Source Serif 4", Georgia, "DejaVu Serif", serif; margin: .7rem 0 .6rem;
  text-wrap: balance; }
h2 { font-size: 1.12rem; margin: 2.6rem 0 .7rem; padding-top: .9rem; border-top: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 0 0 .2rem; }
p { margin: .5rem 0; max-width: 46rem; }
.kicker { color: var(--soft); font-size: .82rem; letter-spacing: .02em; display: flex; gap: .7rem;
  align-items: center; flex-wrap: wrap; }
.badge { font-weight: 600; font-size: .78rem; padding: .16rem .6rem; border-radius: 1rem; color: #fff;
  background: var(--soft); }
.badge.adequate { background: #00734f; } .badge.explained { background: var(--after); }
.badge.unexplained { background: #a63d00; }
.facts { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1.3rem 0 0; padding: 0; list-style: none; }
.facts li { flex: 1 1 11rem; background: var(--wash); border-radius: .5rem; padding: .65rem .9rem; }
.facts small { display: block; color: var(--soft); font-size: .78rem; line-height: 1.35; }
.facts b { font-size: 1.14rem; font-weight: 600; white-space: nowrap; }
.facts b s { text-decoration: none; color: var(--before); font-weight: 500; }
.facts b i { color: var(--soft); font-style: normal; font-weight: 400; }
.card { border: 1px solid var(--line); border-left: 4px solid var(--after); border-radius: .5rem;
  padding: .95rem 1.15rem; margin: .9rem 0; break-inside: avoid; }
.card header { display: flex; justify-content: space-between; gap: 1rem; align-items: baseline;
  flex-wrap: wrap; }
.soft { color: var(--soft); } .small { font-size: .84rem; }
code, .equation, pre { font-family: "JetBrains Mono", "Source Code Pro", Menlo, Consolas, "DejaVu Sans Mono",
  monospace; font-size: .86em; }
.equation { background: var(--wash); border-radius: .35rem; padding: .5rem .8rem; margin: .6rem 0;
  overflow-x: auto; }
table { border-collapse: collapse; width: 100%; margin: .7rem 0; font-size: .89rem; break-inside: avoid; }
th { text-align: left; font-weight: 600; color: var(--soft); font-size: .78rem; vertical-align: bottom; }
th, td { padding: .34rem .9rem .34rem 0; border-bottom: 1px solid var(--line); }
th:last-child, td:last-child { padding-right: 0; }
.n { text-align: right; } .n, .t { white-space: nowrap; } td.t:first-child { padding-right: 1.6rem;
  width: 1%; }
tr:last-child td { border-bottom: 0; }
.scroll { overflow-x: auto; }
figure { margin: 1.1rem 0; break-inside: avoid; } img { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: .84rem; margin-top: .35rem; max-width: 46rem; }
ul.plain { padding-left: 1.1rem; margin: .5rem 0; } ul.plain li { margin: .25rem 0; }
pre { background: var(--wash); border-radius: .5rem; padding: .8rem 1rem; overflow-x: auto;
  white-space: pre-wrap; overflow-wrap: anywhere; }
footer { color: var(--soft); font-size: .8rem; margin-top: 2.4rem; }
@media print { html { font-size: 11.5px; } main { max-width: none; padding: 0; } h2 { break-after: avoid; }
  h2 { margin-top: 1.6rem; } .scroll { overflow: visible; } p, figcaption { max-width: none; }
  figure img { width: 80%; margin: 0 auto; }
  @page { margin: 16mm 15mm; } .badge, .facts li, .equation, pre { print-color-adjust: exact;
  -webkit-print-color-adjust: exact; } }
"""


def page(title: str, body: Iterable[str]) -> str:
    """The whole file."""
    content = "\n".join(part for part in body if part)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        f"<main>\n{content}\n"
        f"<footer>Made by scpjax {scpjax.__version__}.</footer>\n</main>\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """A heading and what stands under it; nothing where there is nothing."""
    inside = "\n".join(p for p in parts if p)
    return f"<section>\n<h2>{escape(title)}</h2>\n{inside}\n</section>" if inside else ""


def text(words: str, kind: str = "") -> str:
    """A paragraph; nothing for no words."""
    return f"<p{_kind(kind)}>{escape(words)}</p>" if words else ""


def bullets(items: Sequence[str]) -> str:
    """A list of sentences."""
    inside = "".join(f"<li>{escape(i)}</li>" for i in items)
    return f'<ul class="plain">{inside}</ul>' if items else ""


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    numeric: Sequence[int] = (),
    tight: Sequence[int] = (),
) -> str:
    """A table of plain cells; columns ``numeric`` are set right; they and ``tight`` do not wrap."""
    if not rows:
        return ""

    def line(cells: Sequence[str], tag: str) -> str:
        kinds = ["n" if i in numeric else "t" if i in tight else "" for i in range(len(cells))]
        return "".join(f"<{tag}{_kind(kind)}>{escape(cell)}</{tag}>" for kind, cell in zip(kinds, cells, strict=True))

    top = f"<thead><tr>{line(head, 'th')}</tr></thead>" if head else ""
    body = "".join(f"<tr>{line(row, 'td')}</tr>" for row in rows)
    return f'<div class="scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def figure(png: bytes, caption: str) -> str:
    """A figure with its picture inside the page."""
    data = base64.b64encode(png).decode("ascii")
    words = escape(caption)
    source = f"data:image/png;base64,{data}"
    return f'<figure><img alt="{words}" src="{source}"><figcaption>{words}</figcaption></figure>'


def facts(items: Sequence[tuple[str, str, str]]) -> str:
    """Numbers to remember: (name, before, after); before may be empty."""
    cells = []
    for name, before, after in items:
        change = f"<s>{escape(before)}</s> <i>→</i> {escape(after)}" if before else escape(after)
        cells.append(f"<li><small>{escape(name)}</small><b>{change}</b></li>")
    return f'<ul class="facts">{"".join(cells)}</ul>' if items else ""


def _kind(name: str) -> str:
    return f' class="{name}"' if name else ""
