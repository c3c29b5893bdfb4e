/* Functions of differences.c, all_pairs.c and halfplanes.c that others call. */
#ifndef MEANFLOCK_NATIVE_H
#define MEANFLOCK_NATIVE_H

#include <stddef.h>
#include <stdint.h>

/* Size of alignment's working memory in doubles, the columns of the velocities included. */
ptrdiff_t alignment_room(int axes, ptrdiff_t n);

/* Mean of ‖v_j − v_i‖ over all N² pairs of n UAVs; the columns of their velocities are at the begin of `room`. */
double alignment(int axes, ptrdiff_t n, double *room);

typedef struct {
    int64_t near, touching; /* pairs at most `hazard` apart at the end; and with a closest approach below `collision` */
    double nearest;         /* least closest approach, m, or the bound if that is less */
} Measured;

/* Size of the working memory of pairs, in doubles. */
ptrdiff_t pairs_room(int axes, ptrdiff_t n);

/* Measures the tick of n UAVs; the columns of their positions before and after are at the begin of `room`.
 * At most `most` of the pairs that touch go into `found`, 16 bytes each. */
Measured pairs(int axes, ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found,
               ptrdiff_t most);

/* Solves one row: wanted (2), normals (count, 2), bounds (count), room for 7 count doubles; writes a (2).
 * Returns `missing` of kernels/halfplanes.py. */
double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a);

#endif
