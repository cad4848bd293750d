"""Charts of how far recorded and simulated clouds are apart over time."""

from __future__ import annotations

from gendom.viz.charts import distance_chart
from gendom.viz.clouds import CloudSequence
from gendom.viz.report.markup import chart_figure
from gendom.viz.report.summary import EstimateSummary


def residual_charts(clouds: CloudSequence, summary: EstimateSummary | None, scene: str) -> str:
    """HTML; empty where nothing is known.

    Args:
        clouds: Both clouds at the frames that were compared.
        summary: The estimate, or None.
        scene: Id of the data of the viewer whose time is marked.
    """
    figures = []
    rms = [] if summary is None else summary.values.get("rms_by_frame") or []
    if len(rms) == clouds.num_frames > 1:
        plot = distance_chart(clouds.times, rms, scene=scene)
        name = "Points to simulated surface [mm]"
        said = (
            "Distance of recorded points from the simulated surface, root mean square in each "
            "frame that was compared."
        )
        figures.append(chart_figure(name, [plot], said))
    if clouds.chamfer is not None and clouds.num_frames > 1:
        plot = distance_chart(clouds.times, clouds.chamfer, scene=scene)
        name = "Chamfer distance of both clouds [mm]"
        said = (
            "Mean distance from each recorded point to the nearest simulated one, plus the mean "
            "distance the other way round. Cameras see one side of the object only, so it is not "
            "zero even for a perfect fit."
        )
        figures.append(chart_figure(name, [plot], said))
    if not figures:
        return ""
    return f'<h3>Residuals over time</h3><div class="pair">{"".join(figures)}</div>'
