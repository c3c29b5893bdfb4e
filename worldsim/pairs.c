/* What worldsim/metrics.py says of large swarms: the same operations in the same order. */
#define LANES 1
#include <math.h>

#include "../swarm/pairwise.h"
#include "tick.h"

/* From the first of n points to all others. */
static TARGET void to_others(ptrdiff_t n, const double *__restrict x, const double *__restrict y, double *__restrict apart) {
    for (ptrdiff_t j = 1; j < n; j++) {
        double along = x[j] - x[0], across = y[j] - y[0];
        apart[j - 1] = sqrt(along * along + across * across);
    }
}

double sum_of_distances(ptrdiff_t n, const double *x, const double *y, double *room) {
    double *apart = room + n;
    if (n < 2) return 0.0;
    for (ptrdiff_t i = 0; i < n - 1; i++) {
        to_others(n - i, x + i, y + i, apart);
        room[i] = sum_of(apart, n - i - 1);
    }
    return sum_of(room, n - 1);
}
