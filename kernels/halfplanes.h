/* The point nearest to a wanted one in half-planes and a disc (kernels/halfplanes.c). */
#ifndef MEANFLOCK_HALFPLANES_H
#define MEANFLOCK_HALFPLANES_H

#include <stddef.h>

/* Of one row: wanted (2), normals (count, 2), bounds (count), room for 7 count doubles; a (2) is written.
 * What is returned is `missing` of kernels/halfplanes.py. */
double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a);

#endif
