"""What is drawn, read back from the axes."""

import importlib
import sys

import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from tests.colours import closest
from tests.motions import two
from torchds import Demonstrations, GMRPolicy, plotting
from torchds.errors import FileError, InvalidArgumentError, MissingPackageError


@pytest.fixture
def axes():
    return Figure().add_subplot()


def legend(axes):
    return axes.get_legend_handles_labels()[1]


def test_limits_hold_all_finite_points_with_a_margin():
    a, b = torch.tensor([[0.0, 1.0], [4.0, torch.nan]]), torch.tensor([[[1.0, 3.0]], [[-1.0, 2.0]]], requires_grad=True)
    (x0, x1), (y0, y1) = plotting.limits(a, b, margin=0.5)
    assert (x0, x1, y0, y1) == (-2.0, 2.0, 0.0, 4.0)  # the box [-1, 1] x [1, 3], half of its longer side added
    assert plotting.limits(torch.full((3, 2), torch.nan)) == ((0, 1), (0, 1))
    (x0, x1), _ = plotting.limits(torch.ones(3, 2))
    assert x0 < 1 < x1


@pytest.fixture
def space():
    return Figure().add_subplot(projection="3d")


def test_limits_of_more_dimensions_are_those_of_the_first_ones():
    track = torch.tensor([[0.0, 1.0, 2.0], [4.0, 3.0, 7.0]])
    assert plotting.limits(track, margin=0.5) == ((-2.0, 6.0), (-1.0, 5.0))
    assert plotting.limits(track, margin=0.0, dims=3) == ((0.0, 4.0), (1.0, 3.0), (2.0, 7.0))


def test_motions_in_space_have_their_third_dimension(space):
    track = torch.rand(2, 5, 6)
    plotting.trajectories(space, track, color="black", label="motion")
    plotting.demonstrations(space, Demonstrations([track[0]], dt=0.1))
    plotting.markers(space, track[:, 0], track[0, -1], {"via": track[0, 1:3]})
    plotting.finish_map(space, "space", "m")
    for line, drawn in zip(space.lines, (*track, track[0]), strict=False):
        np.testing.assert_allclose(np.stack(line.get_data_3d(), -1), drawn[:, :3], rtol=1e-6)
    assert space.get_zlabel() == "x3 [m]" and legend(space) == ["motion", "demonstrations", "start", "goal", "via"]


def test_frames_along_a_motion_are_the_axes_of_its_orientation(space):
    goal = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64)
    turn = torch.linspace(0, np.pi / 2, 11, dtype=torch.float64)
    x = torch.stack([turn, 0 * turn, 0 * turn, 0 * turn, 0 * turn, turn], -1)  # about z, while it moves along x
    plotting.frames(space, x, goal, size=0.5, n=3)
    assert len(space.lines) == 9
    ends = np.stack([np.stack(line.get_data_3d(), -1) for line in space.lines])
    np.testing.assert_allclose(ends[:, 0, 0], np.repeat([0, np.pi / 4, np.pi / 2], 3), atol=1e-12)
    np.testing.assert_allclose(
        ends[6:, 1] - ends[6:, 0], 0.5 * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), atol=1e-12
    )


def test_frames_are_even_along_the_way_also_where_a_motion_slows_down(space):
    t = torch.linspace(0, 8, 801, dtype=torch.float64)
    x = torch.zeros(801, 6, dtype=torch.float64)
    x[:, 1] = torch.exp(-t)
    plotting.frames(space, x, torch.tensor([1.0, 0, 0, 0]).double(), size=0.1, n=5)
    at = [line.get_data_3d()[1][0] for line in space.lines[::3]]
    np.testing.assert_allclose(at, [1, 0.75, 0.5, 0.25, 0], atol=0.005)


def test_what_cannot_be_drawn_is_refused(axes, space, random_policy, random_mixture):
    own = GMRPolicy.from_mixture(random_mixture(batch=(2,)), 2)
    for call, words in (
        (lambda: plotting.field(space, random_policy()), "a field can be drawn in a plane only, got 3-D axes"),
        (lambda: plotting.gaussians(space, random_policy()), "Gaussians can be drawn in a plane only"),
        (lambda: plotting.walls(space, torch.zeros(1, 2, 2)), "walls can be drawn in a plane only"),
        (lambda: plotting.field(axes, random_policy(D=3, O=3)), "of two inputs can be drawn, got one of 3"),
        (
            lambda: plotting.gaussians(axes, random_policy(D=1, O=1)),
            "Gaussians of 1 dimensions cannot be drawn into axes of 2",
        ),
        (
            lambda: plotting.field(axes, random_policy(batch=(3,))),
            r"that of one policy, got a batch \(3,\); give one of it",
        ),
        (lambda: plotting.gaussians(axes, own), r"a gating is that of one policy, got a batch \(2,\)"),
        (lambda: plotting.trajectories(space, torch.zeros(4, 2), color="k", label=""), "of 2 dimensions .* axes of 3"),
        (lambda: plotting.frames(axes, torch.zeros(4, 6), torch.ones(4), size=1.0), "frames need 3-D axes and states"),
    ):
        with pytest.raises(InvalidArgumentError, match=words):
            call()


@pytest.mark.slow
def test_streamlines_follow_the_velocity_of_the_policy(axes, random_policy):
    policy = random_policy()
    axes.set(xlim=(-2, 2), ylim=(-1, 3))
    plotting.field(axes, policy, resolution=80)
    segments = axes.collections[0].get_segments()
    along = np.concatenate([np.diff(line, axis=0) for line in segments])
    middle = np.concatenate([(line[1:] + line[:-1]) / 2 for line in segments])
    long = np.linalg.norm(along, axis=-1) > 1e-6
    along, v = along[long], policy(torch.from_numpy(middle[long])).detach().numpy()
    cosine = (along * v).sum(-1) / np.linalg.norm(along, axis=-1) / np.linalg.norm(v, axis=-1)
    assert len(along) > 100 and np.quantile(cosine, 0.1) > 0.99


def test_ellipses_are_one_standard_deviation(axes, random_policy):
    policy = random_policy(K=3)
    plotting.gaussians(axes, policy)
    assert len(axes.patches) == 3 and legend(axes) == ["Gaussians (1 sd)"]
    for patch, mean, covariance in zip(axes.patches, policy.means.numpy(), policy.covariances.numpy(), strict=True):
        curve = patch.get_patch_transform().transform_path(patch.get_path()).interpolated(1)
        corners = curve.vertices[::3][:9] - mean  # those of the Bézier curves lie on the ellipse
        distance = np.einsum("ni,ij,nj->n", corners, np.linalg.inv(covariance), corners)
        assert distance == pytest.approx(1.0, abs=1e-6)


def test_motions_are_drawn_once_each_with_one_entry_in_the_legend(axes):
    demos, tracks = two(), torch.rand(2, 3, 5, 4, requires_grad=True)
    plotting.demonstrations(axes, demos)
    plotting.trajectories(axes, tracks, color=plotting.AFTER, label="learned")
    assert legend(axes) == ["demonstrations", "learned"] and len(axes.lines) == 2 + 6
    for line, demo in zip(axes.lines, demos, strict=False):
        assert np.array_equal(line.get_xydata(), demo.x.numpy())
    for line, track in zip(axes.lines[2:], tracks.detach().flatten(0, 1), strict=True):
        assert np.array_equal(line.get_xydata(), track[:, :2].numpy()) and line.get_color() == plotting.AFTER


def test_markers_and_walls_stand_where_they_are(axes):
    starts, goal, via = torch.tensor([[1.0, 2.0, 9.0]]), torch.tensor([3.0, 4.0, 9.0]), torch.tensor([[5.0, 6.0]])
    plotting.markers(axes, starts, goal, {"first": via, "second": 2 * via})
    drawn = [line.get_xydata().tolist() for line in axes.lines]
    assert drawn == [[[1, 2]], [[3, 4]], [[5, 6]], [[10, 12]]]
    assert legend(axes) == ["start", "goal", "first", "second"]
    plotting.walls(axes, torch.tensor([[[0.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [1.0, 2.0]]]))
    assert axes.lines[-1].get_xydata().tolist() == [[1, 0], [1, 2]] and legend(axes)[-1] == "walls"


def test_discs_are_where_they_are_with_one_entry_in_the_legend(axes, space):
    plotting.discs(axes, torch.tensor([[0.0, 1.0, 9.0], [2.0, 3.0, 9.0]]), torch.tensor([0.5, 1.5]))
    assert [(*patch.center, patch.radius) for patch in axes.patches] == [(0, 1, 0.5), (2, 3, 1.5)]
    assert legend(axes) == ["forbidden"]
    with pytest.raises(InvalidArgumentError, match=r"have to be \(R, D\) and \(R,\), got shapes \(2, 2\) and \(1,\)"):
        plotting.discs(axes, torch.zeros(2, 2), torch.ones(1))
    with pytest.raises(InvalidArgumentError, match="discs can be drawn in a plane only"):
        plotting.discs(space, torch.zeros(1, 2), torch.ones(1))


def test_a_legend_shows_each_marker_as_it_is_drawn_and_sets_of_via_points_differ(axes):
    points = torch.rand(3, 2)
    plotting.markers(axes, points[:1], points[0], dict.fromkeys(("first", "second", "third", "fourth"), points))
    plotting.finish_map(axes, "")
    entries = axes.get_legend().legend_handles
    assert len(entries) == len(axes.lines) == 6  # nothing is drawn that the legend does not name
    for entry, line in zip(entries, axes.lines, strict=True):
        assert entry.get_label() == line.get_label() and entry.get_markersize() == line.get_markersize()
        assert (
            np.array_equal(outline(entry), outline(line)) and entry.get_markerfacecolor() == line.get_markerfacecolor()
        )
    looks = [outline(line) for line in axes.lines]
    assert not [1 for i, a in enumerate(looks) for b in looks[:i] if a.shape == b.shape and np.allclose(a, b)]


def outline(line):
    return line._marker.get_path().vertices


@pytest.mark.parametrize(
    ("limits", "labels"),
    [
        ((0.0008, 200), ["0.001", "0.01", "0.1", "1", "10", "100"]),
        ((0.3, 6), ["0.5", "1", "2", "5"]),
        ((15, 60), ["20", "50"]),
        ((2e-9, 2e-5), ["1e-08", "1e-07", "1e-06", "0.00001"]),
        ((2.1, 4.8), ["3", "4"]),
        ((10.5, 19), [f"{n}" for n in range(11, 20)]),
        ((1.05, 1.95), [f"1.{n}" for n in range(1, 10)]),
        ((0.21, 0.48), ["0.3", "0.4"]),
        ((5.3, 9.7), ["6", "7", "8", "9"]),
        ((3.001, 3.002), ["3.001", "3.0012", "3.0014", "3.0016", "3.0018", "3.002"]),
    ],
)
@pytest.mark.parametrize("which", ["x", "y"])
def test_axes_of_logarithms_have_plain_numbers(axes, which, limits, labels):
    plotting.log_scale(axes, which)
    axes.set(**{f"{which}lim": limits})
    axis = axes.xaxis if which == "x" else axes.yaxis
    ticks = [tick for minor in (False, True) for tick in axis.get_ticklabels(minor=minor)]
    seen = {text.get_text() for text in ticks if limits[0] <= text.get_position()[which == "y"] <= limits[1]} - {""}
    assert sorted(seen, key=float) == labels


@pytest.mark.parametrize(
    "together",
    [
        ("black", *plotting.TERMS),
        (plotting.FIELD, plotting.DEMONSTRATION, plotting.GAUSSIAN, plotting.BEFORE, plotting.AFTER),
        (plotting.AFTER, *plotting.TERMS[:2]),
        plotting.FRAME,
    ],
)
def test_the_colour_blind_tell_the_colours_of_a_figure_apart(together):
    assert closest(together) >= (15.0,)


def test_the_measure_of_colours_knows_what_is_alike():
    assert closest(("black", "white"))[0] == pytest.approx(100, abs=0.1)
    assert closest(("#1f5fa8", "#8d6cc3")) < (10.0,)  # blue and purple, without red


def test_a_small_map_holds_its_tracks_and_its_legend():
    figure, axes = plotting.small_map(torch.tensor([[0.0, 0.0], [4.0, 2.0]]))
    assert (axes.get_xlim(), axes.get_ylim()) == ((-1, 5), (-1, 3))
    plotting.markers(
        axes, torch.zeros(1, 2), torch.ones(2), {"via-points, left": torch.ones(1, 2), "right": torch.ones(1, 2)}
    )
    plotting.finish_map(axes, "After 500 roll-outs", "mm")
    FigureCanvasAgg(figure).draw()
    for part in (axes.get_legend(), axes.xaxis.label, axes.yaxis.label, axes.title):
        box = part.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= 400 and box.y1 <= 460


def test_a_map_has_equal_axes_and_units(axes):
    axes.plot([0, 1], [0, 1], label="a")
    plotting.finish_map(axes, "A map", "mm", ("x", "z"))
    assert axes.get_aspect() == 1 and (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "z [mm]")
    assert axes.get_title() == "A map" and [text.get_text() for text in axes.get_legend().get_texts()] == ["a"]
    plotting.finish_map(axes, "")
    assert axes.get_xlabel() == "x1"


def test_learning_curves_are_medians_between_quartiles(axes):
    costs = np.random.default_rng(0).uniform(1, 2, (4, 9))
    costs[2, 3] = np.nan  # a failed run is worse than all others
    plotting.learning_curves(axes, [0, 10, 20, 30], {"via_points": costs, "total": 2 * costs})
    first, total = axes.lines
    expected = [sorted([*row[~np.isnan(row)], np.inf])[4] for row in costs]
    assert first.get_ydata() == pytest.approx(expected) and total.get_ydata() == pytest.approx(2 * np.array(expected))
    assert first.get_xdata() == pytest.approx([0, 10, 20, 30])
    assert legend(axes) == ["via-points", "total"] and to_rgba(total.get_color()) == to_rgba("black")
    band = axes.collections[0].get_paths()[0].vertices
    at_start = np.unique(band[band[:, 0] == 0][:, 1])
    assert at_start == pytest.approx([sorted(costs[0])[2], sorted(costs[0])[6]])  # the quartiles of nine
    assert axes.get_yscale() == "log"


def test_more_terms_than_colours_are_told_apart_by_their_lines(axes):
    plotting.learning_curves(axes, [0, 1], {f"term_{i}": [[1.0], [2.0]] for i in range(2 * len(plotting.TERMS) + 1)})
    assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == len(axes.lines)


def test_curves_end_where_most_runs_have_failed(axes):
    inf = np.inf
    plotting.learning_curves(axes, [0, 1, 2], {"total": [[1.0, 2.0, 3.0], [1.0, np.nan, inf], [inf, inf, inf]]})
    FigureCanvasAgg(axes.figure).draw()
    assert axes.lines[0].get_ydata().tolist() == [2.0, inf, inf] and axes.get_yscale() == "log"
    assert 1.0 < axes.get_ylim()[1] < 10
    other = Figure().add_subplot()
    plotting.learning_curves(other, [0, 1], {"total": [[inf], [np.nan]]})
    FigureCanvasAgg(other.figure).draw()


def test_a_negative_cost_needs_a_linear_scale(axes):
    plotting.learning_curves(axes, [0, 1], {"total": [[1.0, 2.0], [-1.0, 2.0]]})
    assert axes.get_yscale() == "linear"


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "torchds.plotting")
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    with pytest.raises(MissingPackageError, match=r"'matplotlib'.*pip install 'torchds\[plot\]'"):
        importlib.import_module("torchds.plotting")


@pytest.mark.slow
def test_a_picture_is_whole_or_the_old_one_stays(axes, tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_text("old")

    def broken(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr("os.fsync", broken)
        with pytest.raises(FileError, match=r"a\.png cannot be written: No space left on device"):
            plotting.save(path, axes.figure)
    assert path.read_text() == "old" and [file.name for file in tmp_path.iterdir()] == ["a.png"]
    plotting.save(path, axes.figure, dpi=10)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_outlines_are_one_standard_deviation_from_the_means():
    policy = GMRPolicy.from_demonstrations(two(), 3)
    points = torch.from_numpy(plotting.outlines(policy, 36))
    offset = points - policy.means[:, None, :2]
    covariance = policy.covariances[:, :2, :2]
    squared = (offset * torch.linalg.solve(covariance[:, None], offset.unsqueeze(-1)).squeeze(-1)).sum(-1)
    torch.testing.assert_close(squared, torch.ones_like(squared))


def test_velocities_on_a_grid_are_those_of_the_policy():
    policy = GMRPolicy.from_demonstrations(two(), 3)
    grid, v = plotting.velocities(policy, (-1.0, 2.0), (0.0, 1.0), 4, 3)
    assert grid.shape == v.shape == (3, 4, 2) and grid[2, 3].tolist() == [2.0, 1.0]
    torch.testing.assert_close(torch.from_numpy(v[1, 2]), policy(torch.from_numpy(grid[1, 2])).detach())
