/* What native.c calls of all_pairs.c and halfplanes.c. */
#ifndef MEANFLOCK_NATIVE_H
#define MEANFLOCK_NATIVE_H

#include <stddef.h>
#include <stdint.h>

/* Doubles that alignment needs room for: columns vx and vy, and the distances of one sum. */
ptrdiff_t alignment_room(ptrdiff_t n);

/* Of n UAVs, whose columns vx and vy lie at the beginning of the room: the mean over all N² pairs of ‖v_j − v_i‖. */
double alignment(ptrdiff_t n, double *room);

typedef struct {
    int64_t near, touching; /* pairs at most `hazard` apart at the end; and with a closest approach below `collision` */
    double nearest;         /* least closest approach, m, or the bound if that is less */
} Measured;

/* Doubles that pairs needs room for. */
ptrdiff_t pairs_room(ptrdiff_t n);

/* Measures the tick of n UAVs; their columns x, y before and x, y after lie at the beginning of the room. The pairs that
 * touch, but `most` at the most, go into `found`, 16 bytes each. */
Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found, ptrdiff_t most);

/* Of one row: wanted (2), normals (count, 2), bounds (count), room for 7 count doubles; a (2) is written.
 * What is returned is `missing` of kernels/halfplanes.py. */
double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a);

#endif
