/* The repulsion from UAVs nearby (kernels/separation.c). */
#ifndef MEANFLOCK_SEPARATION_H
#define MEANFLOCK_SEPARATION_H

#include <stddef.h>

/* Of one row: its state and the n states it knows, 32 bytes each, wherever they begin. Room for 2 n products. */
void repel(const char *state, const char *known, ptrdiff_t n, double weight, double range, double *room, double *pushed);

#endif
