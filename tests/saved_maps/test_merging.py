"""Maps of several runs as one: found without a guess, tied by closures, in the frame of the first."""

from dataclasses import replace

import numpy as np
import pytest

from slammot_graph import InputError, Run, SavedMap
from slammot_graph.core import se2
from slammot_graph.core.saved_map_parts import runs_of_nodes
from slammot_graph.saved_maps import closures_between_runs, merge_maps, moved_trajectory
from tests.localization.saved_maps import hotel_log
from tests.saved_maps.two_halves import errors_m, half, half_map, merged, true_poses


def test_two_maps_come_into_the_frame_of_the_first() -> None:
    both, m = merged().saved, len(half_map(0).nodes)
    assert merged().first_nodes == (0, m)
    assert len(both.nodes) == m + len(half_map(1).nodes)
    assert len(both.runs) == 2
    assert set(both.joined) == {0, both.runs[1].component}
    truth = np.vstack([true_poses(0)[half_map(0).node_scans], true_poses(1)[half_map(1).node_scans]])
    assert errors_m(both.nodes, truth).max() < 0.08
    both._check()


def test_trajectories_move_with_their_nodes() -> None:
    first = merged().first_nodes[1]
    moved = moved_trajectory(half(1).T_map_base, half_map(1), merged().saved.nodes[first:], "second")
    assert errors_m(moved, true_poses(1)).max() < 0.08


def test_runs_may_stand_in_any_order_in_the_trajectory() -> None:
    both, n = merged().saved, len(half(1).stamps)
    runs = tuple(replace(run, first_scan=first) for run, first in zip(both.runs, (n, 0), strict=True))
    T = np.vstack([true_poses(1), true_poses(0)])
    shift = np.array([3.0, -2.0, 0.5])
    moved = moved_trajectory(T, replace(both, runs=runs), se2.compose(shift[None], both.nodes), "both")
    np.testing.assert_allclose(moved[:, :2], se2.compose(shift[None], T)[:, :2], atol=1e-9)


def test_a_trajectory_of_fewer_scans_than_its_map_is_refused() -> None:
    with pytest.raises(InputError, match=r"fewer scans than map\.slam"):
        moved_trajectory(half(1).T_map_base[:50], half_map(1), half_map(1).nodes, "second")


def test_closures_between_the_runs_are_told() -> None:
    closures = closures_between_runs(merged().saved)
    assert len(closures) >= 8
    for closure in closures:
        assert (closure.from_run, closure.to_run) == (0, 1)
        truth = true_poses(1)[closure.to_scan] - true_poses(0)[closure.from_scan]
        assert abs(np.hypot(*truth[:2]) - np.hypot(*closure.T_from_to[:2])) < 0.15
    assert np.median([closure.residual2 for closure in closures]) < 10.0


def test_closures_within_a_map_stay_as_they_are() -> None:
    both = merged().saved
    run_of = runs_of_nodes(both)
    for k in (0, 1):
        n = sum(
            edge.kind == "closure" and run_of[edge.from_node] == run_of[edge.to_node] == k
            for edge in both.edges
        )
        assert n == sum(edge.kind == "closure" for edge in half_map(k).edges)


def test_a_map_of_several_runs_is_merged_as_one() -> None:
    again = merge_maps([half_map(1), merged().saved])
    assert len(again.saved.runs) == 3
    assert len(again.saved.joined) == 2
    components = [run.component for run in again.saved.runs]
    assert set(components) <= set(again.saved.joined)


def test_a_map_without_a_place_in_the_other_is_refused() -> None:
    other = Run(hotel_log((1,), 1)).complete().saved_map
    assert other is not None
    with pytest.raises(InputError, match="hotel: no place of it was found in ring"):
        merge_maps([half_map(0), other], names=["ring", "hotel"])


def test_one_map_alone_or_an_empty_one_is_refused() -> None:
    with pytest.raises(InputError, match="two maps at least"):
        merge_maps([half_map(0)])
    empty: SavedMap = replace(half_map(1), joined=())
    with pytest.raises(InputError, match="holds no local map"):
        merge_maps([half_map(0), empty])
