import json
from pathlib import Path

from command import Lidcam
from perturbed_results import perturbed, turned

ROOT = Path(__file__).parents[2]


def test_a_golden_result_in_ci(lidcam: Lidcam, tmp_path: Path) -> None:
    golden = ROOT / "tests" / "golden" / "sandbox.mcap"
    same = lidcam("compare", golden, golden)
    assert (same.code, same.err) == (0, "")
    assert same.out.splitlines()[-1] == "verdict: equal within the tolerances"
    other = perturbed(golden, tmp_path / "other.mcap", {"/fused/detections": turned(5)})
    differs = lidcam("compare", golden, other, "--json", "--lines", "3")
    assert differs.code == 1
    assert differs.error_line == "lidcam: error: fused: expected at most 0 % of the objects to differ, found 100 %"
    assert json.loads(differs.out)["failure"] in differs.error_line
