/* One haptic frame of ttus_opt, for a loop in C or C++.
 *
 * Python provides both addresses: Renderer.c_function().function and .context. The
 * function takes no lock, allocates nothing and does not use the interpreter. Only one
 * thread may call it at a time; Renderer.update may run in another thread meanwhile.
 */
#ifndef TTUS_FRAME_H
#define TTUS_FRAME_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Returned instead of a count; after the last three the wrench is unchanged. */
enum {
  TTUS_OFF_GRID = -1,  /* no point of the probe lies within the grid: the wrench is 0 */
  TTUS_BAD_POSE = -2,  /* not finite, or not a rotation matrix to 1e-5 */
  TTUS_BAD_TWIST = -3, /* not finite */
  TTUS_BAD_TIME = -4   /* infinite, or before the last one */
};

/* What limited a frame: the wrench was scaled down, as a whole, to the renderer's
 * force_limit or torque_limit, or it fades at an axial end of the grid. */
enum { TTUS_UNLIMITED = 0, TTUS_BY_FORCE = 1, TTUS_BY_TORQUE = 2, TTUS_BY_END = 3 };

/* Word of a context that says what limited its last frame. */
enum { TTUS_LIMIT = 5 };

/* Returns what limited the last frame of a context, for the thread that rendered it. */
static inline int32_t ttus_limit(const void *context) {
  return (int32_t)((const int64_t *)context)[TTUS_LIMIT];
}

/* Renders one pose.
 *
 * context   the address from Python
 * rotation  probe to patient, 3 x 3, row-major [-]
 * position  origin of the probe frame, patient frame [m]
 * twist     velocity of that origin and angular velocity, patient axes [m/s, rad/s];
 *           zeros at rest; only read if time is NAN
 * time      time of the pose [s], from which the twist is estimated; NAN to pass it
 * wrench    out: force on the probe [N], torque about the point shell's reference
 *           point [N m], patient axes; within the renderer's limits, see ttus_limit
 *
 * Returns the number of shell points in contact, or a code above.
 */
typedef int32_t (*ttus_frame_function)(void *context, const double rotation[9],
                                       const double position[3], const double twist[6],
                                       double time, double wrench[6]);

#ifdef __cplusplus
}
#endif

#endif
