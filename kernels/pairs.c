/* What kernels/reference.py says of all pairs: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>
#include <string.h>

#include "pairwise.h"

enum { FEW = 100 }; /* up to here all N² distances are one sum; as in kernels/reference.py */

ptrdiff_t pairs_room(ptrdiff_t n) { return 4 * n + (n <= FEW ? n * n : 2 * n); }

/* From a point to n points (x, y). */
static TARGET void distances(ptrdiff_t n, double from_x, double from_y, const double *__restrict x,
                             const double *__restrict y, double *__restrict apart) {
    for (ptrdiff_t j = 0; j < n; j++) {
        const double along = x[j] - from_x, across = y[j] - from_y;
        apart[j] = sqrt(along * along + across * across);
    }
}

/* From the first of n points to the others, squared: how many are at most `most`, how many less than `least`, and the
 * smallest, if it is less than `nearest`. */
static TARGET int64_t count(ptrdiff_t n, const double *__restrict x, const double *__restrict y, double most,
                            double least, int64_t *touching, double *nearest) {
    int64_t within = 0, closer = 0;
    double smallest[4] = {*nearest, *nearest, *nearest, *nearest}; /* side by side, for none waits for another */
    ptrdiff_t j = 1;
    for (; j + 4 <= n; j += 4)
        for (int k = 0; k < 4; k++) {
            const double along = x[j + k] - x[0], across = y[j + k] - y[0], squared = along * along + across * across;
            within += squared <= most;
            closer += squared < least;
            smallest[k] = squared < smallest[k] ? squared : smallest[k];
        }
    for (; j < n; j++) {
        const double along = x[j] - x[0], across = y[j] - y[0], squared = along * along + across * across;
        within += squared <= most;
        closer += squared < least;
        smallest[0] = squared < smallest[0] ? squared : smallest[0];
    }
    for (int k = 0; k < 4; k++) *nearest = smallest[k] < *nearest ? smallest[k] : *nearest;
    *touching = closer;
    return within;
}

static double mean_distance(ptrdiff_t n, const double *x, const double *y, double *room) {
    if (n <= FEW) {
        for (ptrdiff_t i = 0; i < n; i++) distances(n, x[i], y[i], x, y, room + i * n);
        return sum_of(room, n * n) / (double)(n * n);
    }
    for (ptrdiff_t i = 0; i < n - 1; i++) {
        distances(n - i - 1, x[i], y[i], x + i + 1, y + i + 1, room + n);
        room[i] = sum_of(room + n, n - i - 1);
    }
    return 2.0 * sum_of(room, n - 1) / ((double)n * (double)n);
}

Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, char *found, ptrdiff_t most) {
    const double *x = room, *y = x + n, least = collision * collision;
    Measured seen = {n ? mean_distance(n, y + n, y + 2 * n, room + 4 * n) : 0.0, 0, 0, INFINITY};
    for (ptrdiff_t i = 0; i < n; i++) {
        int64_t left;
        seen.near += count(n - i, x + i, y + i, hazard * hazard, least, &left, &seen.nearest);
        for (ptrdiff_t j = i + 1; left && j < n; j++) {
            const double along = x[j] - x[i], across = y[j] - y[i];
            if (!(along * along + across * across < least)) continue;
            const int64_t pair[] = {i, j};
            if (seen.touching < most) memcpy(found + seen.touching * (ptrdiff_t)sizeof pair, pair, sizeof pair);
            seen.touching++, left--;
        }
    }
    seen.nearest = sqrt(seen.nearest);
    return seen;
}
