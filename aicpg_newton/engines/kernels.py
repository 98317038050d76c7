"""Warp kernels of the Newton engine."""

# Warp's Python stubs do not type what a kernel may do with its arguments.
# pyright: reportArgumentType=false, reportIndexIssue=false, reportOperatorIssue=false, reportCallIssue=false
# pyright: reportAttributeAccessIssue=false, reportGeneralTypeIssues=false

import warp as wp


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
    share: float,
    foot_wrench: wp.array[wp.spatial_vector],
):
    """Sum contact wrenches per foot, moved to the foot frame's origin; ``share`` is one substep's part of the mean."""
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
    wp.atomic_add(foot_wrench, foot, share * wp.spatial_vector(force, moment))


@wp.kernel
def note_buffers(
    step_overflow: wp.array[wp.int32],
    buffers: wp.int32,
    constraint_count: wp.array[wp.int32],
    contact_count: wp.array[wp.int32],
    overflow: wp.array[wp.int32],
    most: wp.array[wp.int32],
):
    """Collect each world's overflow bits of ``buffers``, the most constraints of a world and contacts of all worlds."""
    world = wp.tid()
    overflow[world] = overflow[world] | (step_overflow[world] & buffers)
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
