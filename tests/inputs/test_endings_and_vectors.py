"""Arguments that meant something else: numbers for vectors, endings, devices, tolerances."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError, OutputError, ShapeError, ValueRangeError
from octo.model.gallery import mammal
from octo.mpc import Controller
from octo.problem.codegen import References

ROBOT = mammal()
SETTING = octo.Problem(
    ROBOT, steps=5, dt=0.03, x0=ROBOT.default_pose, costs=[octo.Effort()]
).setting


@pytest.fixture(scope="module")
def solution() -> octo.Solution:
    problem = octo.Problem(ROBOT, steps=5, dt=0.03, x0=ROBOT.default_pose, costs=[octo.Effort()])
    return octo.solve(problem, max_iterations=1, passes=1, device="cpu")


def packed(term) -> np.ndarray:
    return References.of([term], SETTING).pack([term], SETTING)


VECTORS = {
    "CenterOfMassVelocity.velocity": lambda value: octo.CenterOfMassVelocity(value),
    "CenterOfMassPosition.target": lambda value: octo.CenterOfMassPosition(value),
    "CenterOfMassDisplacement.displacement": lambda value: octo.CenterOfMassDisplacement(value),
    "BaseOrientation.roll_pitch_yaw": lambda value: octo.BaseOrientation(value),
    "BaseAngularVelocity.velocity": lambda value: octo.BaseAngularVelocity(value),
    "PointPosition.target": lambda value: octo.PointPosition(target=value),
    "PointPosition.point": lambda value: octo.PointPosition(point=value),
    "PointVelocity.velocity": lambda value: octo.PointVelocity(velocity=value),
    "PoseTarget.target": lambda value: octo.PoseTarget(value),
    "Posture.reference": lambda value: octo.Posture(value),
}


@pytest.mark.parametrize("name", VECTORS)
@pytest.mark.parametrize("value", [0.5, [0.5], [[0.5]], [0.5, 0.1], np.zeros((1, 1, 3)), []])
def test_a_number_or_a_short_list_is_no_vector(name, value):
    with pytest.raises(ShapeError, match=f"{name} has shape"):
        packed(VECTORS[name](value))


@pytest.mark.parametrize("name", VECTORS)
def test_a_vector_and_a_row_for_each_step_are(name):
    size = ROBOT.nx if name.startswith("Po") and not name.startswith("Point") else 3
    rows = np.arange(5.0 * size).reshape(5, size)
    for value in (rows, rows[0], rows[0].tolist(), tuple(rows[0])):
        assert np.isfinite(packed(VECTORS[name](value))).all()
    with pytest.raises(ShapeError, match=rf"^{name.split('.')[0]}\..* has shape \(4, "):
        packed(VECTORS[name](rows[:4]))  # of five steps
    with pytest.raises(ValueRangeError, match=f"{name} is not finite"):
        packed(VECTORS[name](np.full(size, np.nan)))


MEANINGFUL = [
    octo.JointVelocity(0.5),
    octo.BaseHeight(0.3),
    octo.BaseHeight(np.full(5, 0.3)),
    octo.PointPosition(axes=2.0),
    octo.Posture(joints=0.5),
    octo.PoseTarget(ROBOT.default_pose, coordinates=0.1),
]


@pytest.mark.parametrize("term", MEANINGFUL, ids=lambda term: term.label)
def test_one_number_for_all_stays_where_it_means_something(term):
    assert np.isfinite(packed(term)).all()


@pytest.mark.parametrize(
    "term",
    [
        octo.BaseHeight([[0.3]]),
        octo.FootLift(height=[0.1, 0.2]),
        octo.Slip(length=(0.1, 0.1)),
        octo.Slip(length=0.0),
        octo.FrictionCone(mu=[0.5, 0.5]),
        octo.JointLimit(margin=np.zeros(3)),
        octo.TorqueLimit(margin="a"),
        octo.BaseAngularVelocity(axes=(1.0, -1.0, 1.0)),
        octo.Posture(joints=-1.0),
        octo.Effort(reference=-3.0),
    ],
    ids=lambda term: term.label,
)
def test_numbers_that_are_none_are_refused_by_name(term):
    with pytest.raises(OctoError, match=rf"^{term.label}\.") as error:
        packed(term)
    assert "cannot be formed" not in str(error.value)


def test_presets_take_a_speed_or_a_velocity():
    for terms in (
        octo.costs.natural(0.4, length=0.3),
        octo.costs.robot(0.4, length=0.3),
        octo.costs.natural((0.4, 0.0, 0.0), length=0.3),
    ):
        np.testing.assert_allclose(terms[0].velocity, (0.4, 0.0, 0.0))
    for make in (octo.costs.natural, octo.costs.robot):
        for wrong in ([0.4], [0.4, 0.1], [[0.4, 0.0, 0.0]]):
            with pytest.raises(ShapeError, match="speed has shape"):
                make(wrong)
    with pytest.raises(ShapeError, match="velocity has shape"):
        octo.costs.locomotion(0.4)
    with pytest.raises(ShapeError, match="velocity has shape"):
        octo.costs.paper([0.4])
    with pytest.raises(ShapeError, match="yaw_rate has shape"):
        octo.costs.robot(0.4, yaw_rate=(0.0, 0.0, 0.5))


# -- endings --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x.mp4", "x.gif", "x.webm", "x.png", "x", "x.html.gz", ".html"])
def test_a_page_is_written_as_a_page_only(name, solution, tmp_path):
    with pytest.raises(OutputError, match=r"must end in \.html or \.htm"):
        octo.view(solution, tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["x.gif", "x.mp4", "x.html", "x.jpg", "x", "x.npz"])
def test_a_still_picture_is_written_as_one_only(name, solution, tmp_path):
    for draw in (octo.plot, octo.filmstrip):
        with pytest.raises(OutputError, match=r"must end in \.png, \.pdf or \.svg"):
            draw(solution, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_the_ending_says_what_is_written(solution, tmp_path):
    pytest.importorskip("matplotlib")
    begins = {"a.png": b"\x89PNG", "b.PDF": b"%PDF", "c.svg": b"<?xml"}
    for name, first in begins.items():
        octo.plot(solution, tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(first)


def test_other_files_say_what_they_are(solution, tmp_path):
    writers = {
        solution.save: (".npz", "a.csv"),
        solution.to_csv: (".csv", "a.xlsx"),
        lambda path: octo.export_mjcf(ROBOT, path): (".xml", "a.urdf"),
    }
    for write, (ending, wrong) in writers.items():
        with pytest.raises(OutputError, match=rf"must end in \{ending}"):
            write(tmp_path / wrong)
        with pytest.raises(OutputError, match="must be a file's path"):
            write(None)
        write(tmp_path / f"b{ending}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["b.csv", "b.npz", "b.xml"]


def test_a_list_of_records_is_json(tmp_path, capsys):
    for command in (["compare", "biped"], ["bench"]):
        assert main([*command, "--json", str(tmp_path / "a.png")]) == 2
        assert "must end in .json" in capsys.readouterr().err


# -- devices and tolerances -----------------------------------------------------------------


@pytest.mark.parametrize("device", ["gpu", "GPU", "cuda:0", "CUDA", "nvidia", "cup", "", None, 0])
def test_a_device_that_is_none_is_told_all_that_are(device):
    problem = octo.Problem(ROBOT, steps=5, dt=0.03, x0=ROBOT.default_pose, costs=[octo.Effort()])
    for make in (
        lambda: octo.solve(problem, device=device),
        lambda: Controller(problem, device=device),
    ):
        with pytest.raises(
            OctoError, match=r"device .* is not known; valid: cpu, cuda \(an NVIDIA GPU\), auto"
        ):
            make()


def test_the_shell_says_the_same_of_a_gpu(tmp_path, capsys):
    assert main(["solve", "mammal", "--device", "gpu", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "cuda (an NVIDIA GPU)" in said and "did you mean" not in said


LOOSE = [
    (name, value)
    for name in ("tolerance", "dual_tolerance", "step_tolerance")
    for value in (np.inf, np.nan, 1e300, 2.0, 0.0, -1e-6, "small", None)
]


@pytest.mark.parametrize(("name", "value"), LOOSE)
def test_a_tolerance_that_everything_meets_is_refused(name, value):
    with pytest.raises(ValueRangeError, match=f"^{name} is"):
        octo.SqpOptions(**{name: value})


@pytest.mark.parametrize("value", [np.nan, np.inf, 1.0, -1e-9, "flat"])
def test_a_plateau_that_everything_is_on_is_refused(value):
    with pytest.raises(OctoError, match="^plateau_change is"):
        octo.SqpOptions(plateau_change=value)


@pytest.mark.parametrize("value", ["inf", "nan", "1e999", "1e300", "5", "0"])
def test_the_shell_refuses_it_before_anything_is_compiled(value, tmp_path, capsys):
    words = ["compare", "biped", "--goal", "stand", "--seconds", "0.5", "--dt", "0.05"]
    assert main([*words, "--tolerance", value, "--json", str(tmp_path / "a.json")]) == 2
    said = capsys.readouterr().err
    assert "tolerance" in said and (
        "must be a finite number" in said or "at most 1" in said or "positive" in said
    )
    assert not list(tmp_path.iterdir())


def test_a_limit_of_time_may_be_none():
    assert octo.SqpOptions(time_limit=np.inf).time_limit == np.inf
    with pytest.raises(ValueRangeError, match="time_limit is nan"):
        octo.SqpOptions(time_limit=np.nan)
