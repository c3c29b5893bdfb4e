/* What worldsim/metrics.py says of large swarms: the same operations in the same order. */
#define LANES 1
#include <math.h>
#include <stdint.h>

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

/* How many of n points are at most `most` from the first, and less than `least`; both squared. */
static TARGET void count(ptrdiff_t n, const double *__restrict x, const double *__restrict y, double most, double least,
                         int64_t *near, int64_t *touching) {
    int64_t within = 0, closer = 0;
    for (ptrdiff_t j = 1; j < n; j++) {
        double along = x[j] - x[0], across = y[j] - y[0], squared = along * along + across * across;
        within += squared <= most;
        closer += squared < least;
    }
    *near += within;
    *touching = closer;
}

int64_t near_pairs(ptrdiff_t n, const double *x, const double *y, double reach, double most, double least, Found found,
                   void *list) {
    int64_t near = 0, touching;
    for (ptrdiff_t i = 0, end = 0; i < n; i++) {
        while (end < n && x[end] - x[i] <= reach) end++;
        count(end - i, x + i, y + i, most, least, &near, &touching);
        for (ptrdiff_t j = i + 1; j < end && touching; j++) {
            double along = x[j] - x[i], across = y[j] - y[i];
            if (!(along * along + across * across < least)) continue;
            if (!found(list, i, j)) return -1;
            touching--;
        }
    }
    return near;
}
