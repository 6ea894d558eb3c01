"""A self-contained HTML report: score table, stills, timing; everything that comes from data is escaped."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
from jinja2 import Environment

from raw2drive_ros import __version__
from raw2drive_ros.report.video import Video

TEMPLATE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Raw2Drive report: {{ result.driver }}</title>
<style>
body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#1c2430}
table{border-collapse:collapse;width:100%;margin:1em 0}
th,td{padding:.4em .7em;border-bottom:1px solid #d5dae2;text-align:right}
th:first-child,td:first-child,td.left{text-align:left}
.yes{color:#14713d}.no{color:#b3261e}img{width:100%;border-radius:6px;margin:.3em 0 1.2em}
.cards{display:flex;gap:1em;flex-wrap:wrap}.card{flex:1 1 200px;background:#f2f5f9;border-radius:8px;padding:.8em 1em}
.card b{display:block;font-size:1.6em}code{background:#f2f5f9;padding:.1em .3em}
</style></head><body>
<h1>Drive report</h1>
<p>Driver <code>{{ result.driver }}</code>, routes <code>{{ result.suite }}</code>,
suite version {{ result.version }}, protocol {{ result.protocol }}, raw2drive {{ version }}.</p>
<div class="cards">
{% for name in ('pair_success_rate', 'driving_score', 'success_rate', 'route_completion') if result.summary[name] %}
{% set value = result.summary[name] %}
<div class="card">{{ name.replace('_', ' ') }}<b>{{ '%.1f' % value.mean }}</b>
95 %: {{ '%.1f' % value.low }} to {{ '%.1f' % value.high }}</div>
{% endfor %}
<div class="card">speed<b>{{ result.timing.ticks_per_s }}</b>ticks per second;
{% if result.timing.planner_ms %}planner p50 {{ '%.1f' % result.timing.planner_ms.p50 }} ms,
p99 {{ '%.1f' % result.timing.planner_ms.p99 }} ms; {% endif %}{{ result.timing.messages_lost }} messages lost</div>
</div>
<table><tr><th>route</th><th>completion %</th><th>infraction score</th><th>driving score</th><th>success</th>
<th>infractions</th></tr>
{% for row in rows %}
<tr><td>{{ row.id }}</td><td>{{ '%.1f' % row.route_completion }}</td><td>{{ '%.2f' % row.infraction_score }}</td>
<td>{{ '%.1f' % row.driving_score }}</td>
<td class="{{ 'yes' if row.success else 'no' }}">{{ 'yes' if row.success else 'no' }}</td>
<td class="left">{% for name, count in row.infractions.items() %}{{ name }} x{{ count }} {% endfor %}</td></tr>
{% endfor %}</table>
{% for title, picture in stills %}<h3>{{ title }}</h3><img alt="{{ title }}" src="data:image/jpeg;base64,{{ picture }}">
{% endfor %}
</body></html>
"""


def write_report(target: Path, result: dict[str, Any], video: Video | None = None) -> Path:
    """Write the page: failures first, pictures inline, no network access, no script."""
    stills = []
    for episode, picture in (video.stills if video else {}).items():
        encoded = cv2.imencode('.jpg', picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        stills.append((episode, base64.b64encode(encoded.tobytes()).decode()))
    rows = sorted(result['routes'], key=lambda row: (row['success'], row['driving_score']))
    page = Environment(autoescape=True).from_string(TEMPLATE)
    target.write_text(page.render(result=result, rows=rows, stills=stills, version=__version__))
    return target
