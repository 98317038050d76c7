"""Warp kernels of the Newton engine."""

# Warp's Python stubs do not type what a kernel may do with its arguments.
# pyright: reportArgumentType=false, reportIndexIssue=false, reportOperatorIssue=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false

from itertools import accumulate

import warp as wp

from aicpg_newton.robot.humanoid import NUM_JOINTS
from aicpg_newton.robot.locomotion import CONTACT_FORCE

wp.set_module_options({"enable_backward": False})

COMMAND_SIZES = (NUM_JOINTS, NUM_JOINTS, NUM_JOINTS, 3)
"""Numbers of a robot's command: target angles, their rates, torques, push."""

STATE_SIZES = (3, 4, 3, 3, NUM_JOINTS, NUM_JOINTS, NUM_JOINTS, 3, 6, 6)
"""Numbers of each field of a robot's :class:`~aicpg_newton.engines.interface.RobotState`, in its order."""

MEASURE_SIZES = (NUM_JOINTS, NUM_JOINTS, 2, 1)
"""Numbers of each field of a robot's :class:`~aicpg_newton.engines.interface.StepMeasures`, in its order."""

START_SIZES = STATE_SIZES[:6]
"""Those of a :class:`~aicpg_newton.engines.interface.BodyState`."""

_RATE, _TORQUE, _PUSH = map(wp.constant, accumulate(COMMAND_SIZES[:-1]))
_ROTATION, _LINEAR, _ANGULAR, _ANGLES, _RATES, _TORQUES, _HEAD, _FORCE, _MOMENT = map(
    wp.constant, accumulate(STATE_SIZES[:-1])
)

_BRAKING, _CONTACT, _FLIGHT = map(wp.constant, accumulate(MEASURE_SIZES[:-1]))
_CONTACT_FORCE = wp.constant(CONTACT_FORCE)


@wp.func
def _vector(rows: wp.array2d[wp.float32], row: int, first: int):
    return wp.vec3(rows[row, first], rows[row, first + 1], rows[row, first + 2])


@wp.func
def _quaternion(rows: wp.array2d[wp.float32], row: int, first: int):
    return wp.quat(rows[row, first], rows[row, first + 1], rows[row, first + 2], rows[row, first + 3])


@wp.kernel
def write_command(
    command: wp.array2d[wp.float32],
    hinges: wp.array[wp.int32],
    torso: wp.int32,
    position_gain: wp.array2d[wp.float32],
    target_position: wp.array2d[wp.float32],
    target_velocity: wp.array2d[wp.float32],
    wrench_in: wp.array2d[wp.spatial_vector],
    wrench_out: wp.array2d[wp.spatial_vector],
    foot_wrench: wp.array2d[wp.spatial_vector],
    measures: wp.array2d[wp.float32],
    overflow: wp.array[wp.int32],
):
    """Put commands where the solver reads them: a torque is a shift of the position target by tau / Kp.

    A thread for every world and joint. ``wrench_in`` and ``wrench_out`` are the external forces of the two states that
    the physics steps alternate between; only the torso is ever pushed. What the physics steps sum up is set to zero.
    """
    world, joint = wp.tid()
    dof = 6 + hinges[joint]
    shift = command[world, _TORQUE + joint] / position_gain[world, dof]
    target_position[world, 1 + dof] = command[world, joint] + shift
    target_velocity[world, dof] = command[world, _RATE + joint]
    if joint == 0:
        push = _vector(command, world, _PUSH)
        wrench = wp.spatial_vector(push, wp.vec3(0.0, 0.0, 0.0))
        wrench_in[world, torso] = wrench
        wrench_out[world, torso] = wrench
        for foot in range(2):
            foot_wrench[world, foot] = wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
            measures[world, _CONTACT + foot] = 0.0
        measures[world, _FLIGHT] = 0.0
        overflow[world] = 0
    measures[world, joint] = 0.0
    measures[world, _BRAKING + joint] = 0.0


@wp.kernel
def place(
    mask: wp.array[wp.bool],
    start: wp.array2d[wp.float32],
    hinges: wp.array[wp.int32],
    pelvis: wp.int32,
    centre_of_mass: wp.array2d[wp.vec3],
    position: wp.array2d[wp.float32],
    velocity: wp.array2d[wp.float32],
    motor_torque: wp.array2d[wp.float32],
    foot_wrench: wp.array2d[wp.spatial_vector],
):
    """Put masked robots where they start; a thread for every world and joint.

    Newton's free joint carries the velocity of the pelvis's centre of mass.
    """
    world, joint = wp.tid()
    if not mask[world]:
        return
    dof = 6 + hinges[joint]
    position[world, 1 + dof] = start[world, _ANGLES + joint]
    velocity[world, dof] = start[world, _RATES + joint]
    motor_torque[world, dof] = 0.0
    if joint == 0:
        for k in range(7):
            position[world, k] = start[world, k]
        rotation = _quaternion(start, world, _ROTATION)
        linear = _vector(start, world, _LINEAR)
        angular = _vector(start, world, _ANGULAR)
        linear += wp.cross(angular, wp.quat_rotate(rotation, centre_of_mass[world, pelvis]))
        for k in range(3):
            velocity[world, k] = linear[k]
            velocity[world, 3 + k] = angular[k]
        for k in range(6):
            motor_torque[world, k] = 0.0
        for foot in range(2):
            foot_wrench[world, foot] = wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@wp.kernel
def read_state(
    hinges: wp.array[wp.int32],
    pelvis: wp.int32,
    head: wp.int32,
    head_centre: wp.vec3,
    centre_of_mass: wp.array2d[wp.vec3],
    position: wp.array2d[wp.float32],
    velocity: wp.array2d[wp.float32],
    body_pose: wp.array2d[wp.transform],
    motor_torque: wp.array2d[wp.float32],
    foot_wrench: wp.array2d[wp.spatial_vector],
    state: wp.array2d[wp.float32],
):
    """Gather what is told of each robot in the order of ``STATE_SIZES``; a thread for every world and joint."""
    world, joint = wp.tid()
    dof = 6 + hinges[joint]
    state[world, _ANGLES + joint] = position[world, 1 + dof]
    state[world, _RATES + joint] = velocity[world, dof]
    state[world, _TORQUES + joint] = motor_torque[world, dof]
    if joint == 0:
        for k in range(7):
            state[world, k] = position[world, k]
        rotation = _quaternion(position, world, 3)
        linear = _vector(velocity, world, 0)
        angular = _vector(velocity, world, 3)
        linear -= wp.cross(angular, wp.quat_rotate(rotation, centre_of_mass[world, pelvis]))
        top = wp.transform_point(body_pose[world, head], head_centre)
        for k in range(3):
            state[world, _LINEAR + k] = linear[k]
            state[world, _ANGULAR + k] = angular[k]
            state[world, _HEAD + k] = top[k]
            for foot in range(2):
                state[world, _FORCE + 3 * foot + k] = foot_wrench[world, foot][k]
                state[world, _MOMENT + 3 * foot + k] = foot_wrench[world, foot][3 + k]


@wp.kernel
def add_foot_wrenches(
    contact_count: wp.array[wp.int32],
    contact_shape0: wp.array[wp.int32],
    contact_shape1: wp.array[wp.int32],
    contact_point0: wp.array[wp.vec3],
    contact_point1: wp.array[wp.vec3],
    contact_wrench: wp.array[wp.spatial_vector],
    foot_of_shape: wp.array[wp.int32],
    foot_body: wp.array[wp.int32],
    body_pose: wp.array[wp.transform],
    foot_wrench: wp.array[wp.spatial_vector],
):
    """Sum the contact wrenches of a physics step per foot, moved to the foot frame's origin."""
    contact = wp.tid()
    if contact >= contact_count[0]:
        return
    wrench = contact_wrench[contact]  # on shape 0, at the contact point, world frame
    point = contact_point0[contact]  # in the body's frame
    foot = wp.int32(-1)
    if contact_shape0[contact] >= 0:
        foot = foot_of_shape[contact_shape0[contact]]
    if foot < 0 and contact_shape1[contact] >= 0:
        foot = foot_of_shape[contact_shape1[contact]]
        wrench = -wrench
        point = contact_point1[contact]
    if foot < 0:
        return
    arm = wp.quat_rotate(wp.transform_get_rotation(body_pose[foot_body[foot]]), point)
    force = wp.spatial_top(wrench)
    moment = wp.spatial_bottom(wrench) + wp.cross(arm, force)
    wp.atomic_add(foot_wrench, foot, wp.spatial_vector(force, moment))


@wp.kernel
def measure_step(
    velocity_before: wp.array2d[wp.float32],
    velocity_after: wp.array2d[wp.float32],
    hinges: wp.array[wp.int32],
    motor_torque: wp.array2d[wp.float32],
    share: float,
    step_wrench: wp.array2d[wp.spatial_vector],
    step_overflow: wp.array[wp.int32],
    buffers: wp.int32,
    constraint_count: wp.array[wp.int32],
    contact_count: wp.array[wp.int32],
    foot_wrench: wp.array2d[wp.spatial_vector],
    measures: wp.array2d[wp.float32],
    overflow: wp.array[wp.int32],
    ever: wp.array[wp.int32],
    most: wp.array[wp.int32],
):
    """Add a physics step to the measures of the control step; a thread for every world and joint.

    Power, contact and the mean of the feet's wrenches, of which the step is a ``share``; ``step_wrench`` is zero again
    afterwards. And each world's overflow bits of ``buffers``, most constraints of a world and contacts of all worlds.
    """
    world, joint = wp.tid()
    dof = 6 + hinges[joint]
    power = motor_torque[world, dof] * 0.5 * (velocity_before[world, dof] + velocity_after[world, dof])
    measures[world, joint] += share * wp.max(power, 0.0)
    measures[world, _BRAKING + joint] += share * wp.max(-power, 0.0)
    if joint > 0:
        return
    feet_down = wp.int32(0)
    for foot in range(2):
        wrench = step_wrench[world, foot]
        foot_wrench[world, foot] += share * wrench
        if wrench[2] > _CONTACT_FORCE:
            measures[world, _CONTACT + foot] += share
            feet_down += 1
        step_wrench[world, foot] = wp.spatial_vector(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if feet_down == 0:
        measures[world, _FLIGHT] += share
    overflow[world] = overflow[world] | (step_overflow[world] & buffers)
    ever[world] = ever[world] | overflow[world]
    wp.atomic_max(most, 0, constraint_count[world])
    if world == 0:
        wp.atomic_max(most, 1, contact_count[0])


@wp.kernel
def note_lost_contacts(
    triangle_count: wp.array[wp.int32],
    triangle_max: wp.int32,
    unbuffered: wp.array[wp.int32],
    unreduced: wp.array[wp.int32],
    overflow: wp.array[wp.int32],
):
    """Mark all worlds when the collision detection, whose buffers they share, ran out of one of them."""
    if triangle_count[0] > triangle_max or unbuffered[0] > 0 or unreduced[0] > 0:
        overflow[wp.tid()] = -1
