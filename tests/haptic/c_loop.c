/* A haptic loop in a thread of its own, which the interpreter knows nothing of. */
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>

#include "ttus_frame.h"

typedef struct {
  ttus_frame_function frame;
  void *context;
  int64_t n;                /* poses */
  const double *rotation;   /* n x 9 */
  const double *position;   /* n x 3 */
  const double *twist;      /* n x 6 */
  const double *time;       /* n, NAN where the twist is given */
  double *wrench;           /* n x 6 */
  int32_t *count;           /* n */
  int64_t rounds;           /* over all poses; below 0 until `stop` is set */
  _Atomic int64_t stop;
  _Atomic int64_t frames;   /* rendered so far */
  pthread_t thread;
} loop;

static void *run(void *pointer) {
  loop *l = pointer;
  for (int64_t round = 0; round != l->rounds && !l->stop; ++round)
    for (int64_t i = 0; i < l->n; ++i) {
      l->count[i] = l->frame(l->context, l->rotation + 9 * i, l->position + 3 * i,
                             l->twist + 6 * i, l->time[i], l->wrench + 6 * i);
      ++l->frames;
    }
  return 0;
}

int loop_start(loop *l) { return pthread_create(&l->thread, 0, run, l); }

int loop_join(loop *l) { return pthread_join(l->thread, 0); }

int32_t last_limit(const void *context) { return ttus_limit(context); }
