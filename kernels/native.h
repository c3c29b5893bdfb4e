/* What native.c calls of pairs.c, halfplanes.c and separation.c. */
#ifndef MEANFLOCK_NATIVE_H
#define MEANFLOCK_NATIVE_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    double speed_difference; /* mean over all N² pairs of ‖v_j − v_i‖, m/s */
    int64_t near, touching;  /* pairs i < j at most `hazard`, and less than `collision` metres apart */
    double nearest;          /* of all pairs the least distance, m; infinite where there is none */
} Measured;

/* Doubles that pairs needs room for: columns x, y, vx, vy, and the distances of one sum. */
ptrdiff_t pairs_room(ptrdiff_t n);

/* Measures n UAVs, whose columns lie at the beginning of the room; the first `most` touching pairs go into `found`, 16 bytes each. */
Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, char *found, ptrdiff_t most);

/* Of one row: wanted (2), normals (count, 2), bounds (count), room for 7 count doubles; a (2) is written.
 * What is returned is `missing` of kernels/halfplanes.py. */
double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a);

/* Of one row: its state and the n states it knows, 32 bytes each, wherever they begin. Room for 2 n products. */
void repel(const char *state, const char *known, ptrdiff_t n, double weight, double range, double *room, double *pushed);

#endif
