"""Layout of the view: the scene, the decisions of the policy, and the measurements."""

from __future__ import annotations

from typing import Any

from flowbothd.view.entities import DECISIONS, FORCE, OPENING, PHASE, TRIALS, VACUUM, WORLD


def blueprint() -> Any:
    """The layout that opens with every recording."""
    import rerun.blueprint as rrb

    scene = rrb.Spatial3DView(
        origin=f"/{WORLD}",
        name="Scene: grey camera, blue robot, green object, arrows flow, red grasp",
        background=[20, 22, 26],
        eye_controls=rrb.EyeControls3D(
            position=(-0.25, -1.05, 0.75), look_target=(0.25, 0.0, 0.3), eye_up=(0.0, 0.0, 1.0)
        ),
        line_grid=False,
    )
    phases = (
        [rrb.StateTimelineView(origin=f"/{PHASE}", name="What the policy waits for")]
        if hasattr(rrb, "StateTimelineView")
        else []
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                scene,
                rrb.TextLogView(origin=f"/{DECISIONS}", name="Decisions and their reasons"),
                row_shares=[3, 1],
            ),
            rrb.Vertical(
                *phases,
                rrb.TimeSeriesView(origin=f"/{OPENING}", name="Opening (1 = target, goal 0.9)"),
                rrb.TimeSeriesView(origin=f"/{TRIALS}", name="Samples rejected for this step"),
                rrb.TimeSeriesView(origin=f"/{VACUUM}", name="Vacuum [kPa]"),
                rrb.TimeSeriesView(origin=f"/{FORCE}", name="Force at the tool [N]"),
            ),
            column_shares=[5, 3],
        ),
        rrb.TimePanel(state="collapsed", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
    )
