/* A field of ttus_opt in C, without Python: read a flat file, render poses.
 *
 * The file is written by `ttus-opt render --flat`. C99, no library but libm,
 * little-endian machines. Frames allocate nothing and take no lock; two threads need a
 * field each, because a frame writes scratch memory of its field.
 */
#ifndef TTUS_READER_H
#define TTUS_READER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct ttus_field ttus_field;

/* Returned instead of a count. */
enum {
  TTUS_READER_OFF_GRID = -1, /* no point of the probe lies in the grid: the wrench is 0 */
  TTUS_READER_BAD_POSE = -2  /* not finite, or no rotation to 1e-5: wrench unchanged */
};

/* Reads a file; NULL if that fails, and then *error says why. */
ttus_field *ttus_load(const char *path, const char **error);

/* Force on the probe [N] and torque about the point shell's reference point [N m] in
 * patient axes, scaled down as a whole to the file's limits.
 *
 * rotation  probe to patient, 3 x 3, row-major [-]; rounding up to 1e-5 is corrected
 * position  origin of the probe frame, patient frame [m]
 *
 * Returns the number of shell points in contact, or a code above. */
int32_t ttus_render(ttus_field *field, const double rotation[9],
                    const double position[3], double wrench[6]);

void ttus_free(ttus_field *field); /* NULL is fine */

#ifdef __cplusplus
}
#endif

#endif
