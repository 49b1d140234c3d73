"""Nothing lost and nothing done twice, whatever is broken, killed or full: the stress benchmark with few clips."""

from pathlib import Path

import pytest
from batch_stress import stress
from report import Report


@pytest.mark.exhaustive
def test_a_disturbed_batch_ends_as_one_that_nobody_disturbs(tmp_path: Path) -> None:
    report = Report()
    stress(report, tmp_path, n_clips=12)
    assert report.missed == []
