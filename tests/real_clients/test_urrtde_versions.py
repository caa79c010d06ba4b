"""Functions of ur_rtde for newer controllers only, and its other range of registers."""

from collections.abc import Callable

import numpy as np
import pytest
import ur_analytic_ik
from pose_matrices import Array
from rig import START_Q, Rig, disconnecting
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

newest = pytest.mark.parametrize("rig", ["ur5e"], indirect=True)  # PolyScope 5.26
e_series = pytest.mark.parametrize("rig", ["ur3e"], indirect=True)


def call_twice(rig: Rig, question: Callable[[], list[float]]) -> Array:
    """Call twice: these calls return the contents of registers, which are stale the first time."""
    question()
    with rig.watch() as state:
        state.wait_for(0.05)
    return np.array(question())


@newest
def test_jacobian_against_finite_differences(rig: Rig, control: RTDEControlInterface) -> None:
    columns = call_twice(rig, control.getJacobian).reshape(6, 6)
    step = 1e-6
    here = ur_analytic_ik.ur5e.forward_kinematics(*START_Q)
    for joint in range(6):
        q = np.array(START_Q)
        q[joint] += step
        moved = ur_analytic_ik.ur5e.forward_kinematics(*q)
        spin = (moved[:3, :3] - here[:3, :3]) @ here[:3, :3].T / step
        expected = [*((moved[:3, 3] - here[:3, 3]) / step), spin[2, 1], spin[0, 2], spin[1, 0]]
        assert columns[joint] == pytest.approx(expected, abs=1e-4)


@newest
def test_the_mass_matrix_is_physically_valid(rig: Rig, control: RTDEControlInterface) -> None:
    mass = call_twice(rig, control.getMassMatrix).reshape(6, 6)
    np.testing.assert_allclose(mass, mass.T, atol=1e-9)
    assert np.linalg.eigvalsh(mass).min() > 0
    assert mass[0, 0] > mass[5, 5]


@newest
def test_speeds_and_accelerations_are_zero_at_rest(rig: Rig, control: RTDEControlInterface) -> None:
    assert call_twice(rig, control.getCoriolisAndCentrifugalTorques) == pytest.approx([0.0] * 6, abs=1e-9)
    assert call_twice(rig, control.getTargetJointAccelerations) == pytest.approx([0.0] * 6, abs=1e-9)
    assert call_twice(rig, control.getJacobianTimeDerivative) == pytest.approx([0.0] * 36, abs=1e-9)


@pytest.mark.parametrize("rig", ["ur5e dynamic"], indirect=True)
def test_direct_torque_carries_the_arm_and_pushes_it(rig: Rig, control: RTDEControlInterface) -> None:
    def push(base_torque: float, seconds: float) -> None:
        for _ in range(round(seconds / rig.period_s)):
            began = control.initPeriod()
            assert control.directTorque([base_torque, 0.0, 0.0, 0.0, 0.0, 0.0])
            control.waitPeriod(began)

    with rig.watch() as state:
        push(0.0, 0.3)  # gravity is compensated by default
        assert state.wait_for(0.05)["actual_q"] == pytest.approx(START_Q, abs=1e-3)
        push(20.0, 0.2)
        control.stopScript()
        state.wait_until_still(timeout_s=3)
        assert state.settled()["actual_q"][0] > START_Q[0] + 0.01


@e_series
def test_upper_range_of_registers(rig: Rig) -> None:
    flags = RTDEControlInterface.FLAGS_DEFAULT | RTDEControlInterface.FLAG_UPPER_RANGE_REGISTERS
    control = RTDEControlInterface(rig.host, -1.0, flags)
    receive = RTDEReceiveInterface(rig.host, -1.0, [], False, True)
    io = RTDEIOInterface(rig.host, False, True)
    target = [START_Q[0] + 0.2, *START_Q[1:]]
    body = (
        "    write_output_integer_register(36, read_input_integer_register(42))\n"
        "    write_output_float_register(43, read_input_float_register(46))\n"
    )
    with disconnecting(control, receive, io), rig.watch("input_double_register_46") as state:
        assert control.moveJ(target, 2.0, 8.0)
        assert state.settled()["actual_q"] == pytest.approx(target, abs=1e-5)
        assert io.setInputIntRegister(42, 1234)
        assert io.setInputDoubleRegister(46, -0.5)
        state.wait_until(lambda sample: sample["input_double_register_46"] == -0.5)
        assert control.sendCustomScriptFunction("copy", body)
        rig.eventually(lambda: receive.getOutputDoubleRegister(43) == -0.5)
        assert receive.getOutputIntRegister(36) == 1234
