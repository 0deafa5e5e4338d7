from hypothesis import given
from hypothesis import strategies as st

from slammot_graph.localization.innovation_gate import InnovationGate

scans = st.lists(st.lists(st.floats(0.0, 1e4), min_size=1, max_size=3), max_size=30)


def test_one_leap_is_taken_and_a_series_is_not() -> None:
    gate, outcomes = InnovationGate(max_nis=16.0, max_counted_nis=50.0, gain=0.1), []
    for _ in range(8):
        gate.start_scan()
        outcomes.append(gate.is_improbable(1000.0))
    # 50 (1 - 0.9^n) passes 16 at the fourth
    assert outcomes == 3 * [False] + 5 * [True]
    gate.start_scan()
    assert not gate.is_improbable(1.0)


@given(scans)
def test_a_scan_counts_by_its_last_match_alone(nis: list[list[float]]) -> None:
    gate, once = (InnovationGate(max_nis=16.0, max_counted_nis=50.0, gain=0.1) for _ in range(2))
    for of_scan in nis:
        gate.start_scan()
        once.start_scan()
        for value in of_scan:
            refused = gate.is_improbable(value)
            assert not refused or value > 16.0
        assert once.is_improbable(of_scan[-1]) == refused
        assert gate.mean_nis == once.mean_nis
        assert 0.0 <= gate.mean_nis <= 50.0
