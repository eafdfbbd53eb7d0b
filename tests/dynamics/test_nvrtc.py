"""The text of the dynamics compiles for GPUs, without one, and its kernels keep their numbers in registers."""

from __future__ import annotations

from importlib import resources

import casadi as ca
import pytest

from octo.dynamics.evaluate import CustomDynamics, RobotDynamics
from octo.dynamics.laws import Compliant
from octo.errors import DeviceError, MissingExtraError
from octo.gpu import nvrtc
from octo.model.gallery import CHARACTERS

# Bytes a thread: the curvature of one contact keeps 90 doubles alive (measured with NVRTC 13.0: 128).
ALLOWED_SPILL = {"octo_curvature": 192}
KERNELS = {"octo_work_size", "octo_kin_of_nodes", "octo_value", "octo_jacobian", "octo_curvature"}


@pytest.fixture(scope="module", autouse=True)
def compiler():
    try:
        return nvrtc.compile_text('extern "C" __global__ void nothing() {}')
    except MissingExtraError:
        pytest.skip("nvidia-cuda-nvrtc is not installed")


def kernels():
    return "".join((resources.files("octo.gpu") / name).read_text() for name in ("common.cuh", "dynamics.cu"))


def check(text, architecture):
    binary = nvrtc.compile_text(text + kernels(), architecture)
    assert binary.cubin[:4] == b"\x7fELF"
    assert set(binary.kernels) == KERNELS
    for kernel in binary.kernels.values():
        assert max(kernel.spill_stores, kernel.spill_loads) <= ALLOWED_SPILL.get(kernel.name, 0), kernel


@pytest.mark.parametrize(
    ("name", "architecture"), [*((name, "sm_90") for name in CHARACTERS), ("mammal", "sm_80"), ("humanoid", "sm_80")]
)
def test_gallery(name, architecture):
    check(RobotDynamics(CHARACTERS[name]()).text(), architecture)


def test_another_law():
    binary = nvrtc.compile_text(RobotDynamics(CHARACTERS["chain"](), Compliant()).text() + kernels())
    assert binary.kernels["octo_jacobian"].spill_stores == 0


def test_user_written_dynamics():
    dynamics = CustomDynamics(lambda x_next, x, x_prev, p: ca.sin(x_next) - 2.0 * x + x_prev, 2, [0], {})
    check(dynamics.text(), "sm_90")


def test_wrong_text_is_refused_with_the_log():
    with pytest.raises(DeviceError, match="nonsense"):
        nvrtc.compile_text("nonsense")
