/* Functions of differences.c, all_pairs.c, halfplanes.c and halfspaces.c that others call. */
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

enum { NEAREST_ROOM = 9 }; /* doubles of working memory for each half-plane or half-space */

/* Solves one row: wanted (2), normals (count, 2), bounds (count), room; writes a (2).
 * Returns `missing` of kernels/halfspaces.py. */
double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a);

/* The same in space: wanted (3), normals (count, 3), a (3). */
double nearest_in_space(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
                        double *room, double *a);

typedef struct {
    const double *x, *y, *bound; /* an unused half-plane has the bound −∞ */
    const double *length;        /* of the given normals */
    ptrdiff_t count;
} Planes;

/* Returns whether a point satisfies all half-planes with unit normals, each eased by `ease`; `a` is the point nearest to
 * `wanted`, of all half-planes or, without such a point, of those before the first contradiction. */
int project(Planes p, double ease, const double *wanted, double limit, double *a);

#endif
