"""A campaign in a process that is to be killed; apart from the cases, whose children need no Dask."""

from __future__ import annotations

from pathlib import Path

import bench_cases

from malipp_field.bench.campaign import Campaign, Piece
from malipp_field.bench.farm import Farm
from malipp_field.bench.labour import Terms


def run_until_killed(folder: Path) -> None:
    """Run a study of which only two plans end, and tell how far it is; for a process to be killed."""
    campaign = Campaign([bench_cases.study(instances=1)], folder, Terms(run=bench_cases.stop_after_two))
    with Farm[Piece](None, 1) as farm:
        campaign.run(farm, lambda standing: print(standing.done, flush=True))
