/* Compiled form of differences.py: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>

#include "pairwise.h"

enum { FEW = 100 }; /* as in differences.py */
enum { BLOCK = 1024 }; /* columns of the sums that stay in the cache; any number gives the same bits */

ptrdiff_t alignment_room(ptrdiff_t n) { return 2 * n + (n <= FEW ? n * n : 2 * n); }

/* Distances from a point to n points (x, y). */
static TARGET void distances(ptrdiff_t n, double from_x, double from_y, const double *__restrict x,
                             const double *__restrict y, double *__restrict apart) {
    for (ptrdiff_t j = 0; j < n; j++) {
        const double along = x[j] - from_x, across = y[j] - from_y;
        apart[j] = sqrt(along * along + across * across);
    }
}

/* Adds the distances from a point to n points (x, y). */
static TARGET void add_distances(ptrdiff_t n, float from_x, float from_y, const float *__restrict x,
                                 const float *__restrict y, double *__restrict sums) {
    for (ptrdiff_t j = 0; j < n; j++) {
        const float along = x[j] - from_x, across = y[j] - from_y;
        sums[j] += (double)sqrtf(along * along + across * across);
    }
}

/* Σ_{i < j} ‖u_j − u_i‖ of velocities relative to their mean, in single precision; `room` for 2 n doubles. */
static double sum_of_all(ptrdiff_t n, const double *x, const double *y, double *room) {
    double *sums = room;
    float *to_x = (float *)(room + n), *to_y = to_x + n;
    for (ptrdiff_t j = 0; j < n; j++) sums[j] = 0.0, to_x[j] = (float)x[j], to_y[j] = (float)y[j];
    for (ptrdiff_t start = 0; start < n; start += BLOCK) {
        const ptrdiff_t end = n - start < BLOCK ? n : start + BLOCK;
        for (ptrdiff_t i = 0; i < end - 1; i++) {
            const ptrdiff_t from = i < start ? start : i + 1;
            add_distances(end - from, to_x[i], to_y[i], to_x + from, to_y + from, sums + from);
        }
    }
    return sum_of(sums, n);
}

double alignment(ptrdiff_t n, double *room) {
    double *x = room, *y = x + n;
    room += 2 * n;
    if (!n) return 0.0;
    if (n > FEW) {
        const double mean_x = sum_of(x, n) / (double)n, mean_y = sum_of(y, n) / (double)n;
        for (ptrdiff_t j = 0; j < n; j++) x[j] -= mean_x, y[j] -= mean_y;
        return 2.0 * sum_of_all(n, x, y, room) / ((double)n * (double)n);
    }
    for (ptrdiff_t i = 0; i < n; i++) distances(n, x[i], y[i], x, y, room + i * n);
    return sum_of(room, n * n) / (double)(n * n);
}
