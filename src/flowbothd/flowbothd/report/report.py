"""The report of one run: summary, signals, pictures, and the decision log on one page."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from flowbothd.view.cloud_pictures import draw_choices
from flowbothd_evaluation.run_record.pictures import View, draw_strip, write_animation
from flowbothd_evaluation.run_record.record import RunRecord
from flowbothd_evaluation.run_record.signals import plot_signals
from franka_suction_driver.arm.description import compose_urdf
from sim_bridge.objects.registry import load_object
from sim_bridge.scenes import Scene
from sim_bridge.world import ArmWorld

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; }}
body {{ padding: 0 1rem; }}
img {{ max-width: 100%; }} table {{ border-collapse: collapse; }}
td, th {{ border-bottom: 1px solid #ddd; padding: .2rem .7rem; }}
td, th {{ text-align: left; vertical-align: top; }}
.numbers td:first-child {{ color: #666; }} .log {{ font-size: 13px; }}
</style></head><body>
<h1>{title}</h1>
<table class="numbers">{summary}</table>
<h2>The run</h2>
<p>Green: the predicted flow that was acted upon. Red: the grasp point and its direction.</p>
{pictures}
<h2>What the policy noticed and did</h2>
<img src="signals.png" alt="policy signals">
<h2>Motions</h2>
<table class="log"><tr><th>t [s]</th><th>motion</th><th>ended by</th><th>peak force [N]</th>
<th>moved [cm]</th><th>message</th></tr>{motions}</table>
<h2>Decisions</h2>
<table class="log"><tr><th>t [s]</th><th>event</th><th>decision</th><th>step</th><th>grasps</th>
<th>trials</th><th>why</th></tr>{decisions}</table>
</body></html>
"""


def _row(values: list[object]) -> str:
    return "<tr>" + "".join(f"<td>{html.escape(str(value))}</td>" for value in values) + "</tr>"


_ROLLOUT = '<img src="rollout.png" alt="decisive moments">'
_ANIMATION = '<p><img src="rollout.gif" alt="animation of the run"></p>'
_CHOICES = '<p><img src="choices.png" alt="what the policy saw and chose at every step"></p>'


def _page(record: RunRecord, pictures: list[str]) -> str:
    summary = record.summary()
    motions = [
        _row(
            [
                f"{m.time:.1f}",
                m.motion,
                m.reason,
                f"{m.peak_force:.0f}",
                f"{100 * float(np.linalg.norm(m.tool_motion)):.1f}",
                m.message,
            ]
        )
        for m in record.motions
    ]
    decisions = [
        _row([f"{d.time:.1f}", d.event, d.decision, d.step, d.grasps, d.trials, d.reason])
        for d in record.decisions
    ]
    title = f"{record.object} {record.mode}: {summary.outcome}".strip()
    return _PAGE.format(
        title=html.escape(title),
        pictures="\n".join(pictures),
        summary="".join(_row([key, value]) for key, value in vars(summary).items()),
        motions="".join(motions),
        decisions="".join(decisions),
    )


def write_report(
    record: RunRecord, scene: Scene | None, folder: Path, *, animation: bool = True
) -> None:
    """Write report.html and its pictures into `folder`.

    Args:
        record: The run.
        scene: That was simulated; None = draw what was seen, without a world.
        folder: Is made if need be.
        animation: Whether the run is drawn as a moving picture too.
    """
    folder.mkdir(parents=True, exist_ok=True)
    plot_signals(record, folder / "signals.png")
    pictures = []
    if scene is not None:
        model = load_object(scene.object, mode=record.mode or None, seed=record.seed)
        view = View(scene.report_eye, scene.report_target)
        with ArmWorld(compose_urdf(), model, scene.T_base_object) as world:
            draw_strip(record, world, view, folder / "rollout.png")
            pictures.append(_ROLLOUT)
            if animation:
                write_animation(record, world, view, folder / "rollout.gif")
                pictures.append(_ANIMATION)
    if draw_choices(record, folder / "choices.png"):
        pictures.append(_CHOICES)
    (folder / "report.html").write_text(_page(record, pictures))
