/* All pairs of a swarm (kernels/pairs.c). */
#ifndef MEANFLOCK_PAIRS_H
#define MEANFLOCK_PAIRS_H

#include <stddef.h>
#include <stdint.h>

enum { FEW = 100 }; /* up to here all N² distances are one sum; as in kernels/reference.py */

typedef struct {
    double speed_difference; /* mean over all N² pairs of ‖v_j − v_i‖, m/s */
    int64_t near, touching;  /* pairs i < j at most `hazard`, and less than `collision` metres apart */
    double nearest;          /* of all pairs the least distance, m; infinite where there is none */
} Measured;

/* Doubles that pairs needs room for: columns x, y, vx, vy, and the distances of one sum. */
ptrdiff_t pairs_room(ptrdiff_t n);

/* Measures n UAVs, whose columns lie at the beginning of the room; the first `most` touching pairs go into `found`, 16 bytes each. */
Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, char *found, ptrdiff_t most);

#endif
