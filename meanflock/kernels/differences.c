/* Compiled form of differences.py: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>

#include "axes.h"
#include "pairwise.h"

enum { FEW = 100 }; /* as in differences.py */
enum { BLOCK = 1024 }; /* columns of the sums that stay in the cache; any number gives the same bits */

ptrdiff_t alignment_room(int axes, ptrdiff_t n) { return axes * n + (n <= FEW ? n * n : n + axes * n); }

/* Distances from the i-th of n points to all of them, which are in columns. */
FOR_AXES void distances(const int axes, ptrdiff_t n, const double *__restrict points, ptrdiff_t i,
                        double *__restrict apart) {
    double from[MOST_AXES], way[MOST_AXES];
    for (int k = 0; k < axes; k++) from[k] = points[k * n + i];
    for (ptrdiff_t j = 0; j < n; j++) {
        for (int k = 0; k < axes; k++) way[k] = points[k * n + j] - from[k];
        apart[j] = sqrt(inner(axes, way, way));
    }
}

/* Adds the distances from a point to `count` points; all are in columns, `step` numbers apart. */
FOR_AXES void add_distances(const int axes, ptrdiff_t step, ptrdiff_t count, const float *__restrict from,
                            const float *__restrict points, double *__restrict sums) {
    float at[MOST_AXES], way[MOST_AXES];
    for (int k = 0; k < axes; k++) at[k] = from[k * step];
    for (ptrdiff_t j = 0; j < count; j++) {
        for (int k = 0; k < axes; k++) way[k] = points[k * step + j] - at[k];
        float squared = way[0] * way[0];
        for (int k = 1; k < axes; k++) squared += way[k] * way[k];
        sums[j] += (double)sqrtf(squared);
    }
}

static TARGET void distances_in_plane(ptrdiff_t n, const double *__restrict points, ptrdiff_t i,
                                      double *__restrict apart) {
    distances(PLANE, n, points, i, apart);
}

static TARGET void distances_in_space(ptrdiff_t n, const double *__restrict points, ptrdiff_t i,
                                      double *__restrict apart) {
    distances(SPACE, n, points, i, apart);
}

static TARGET void add_distances_in_plane(ptrdiff_t step, ptrdiff_t count, const float *__restrict from,
                                          const float *__restrict points, double *__restrict sums) {
    add_distances(PLANE, step, count, from, points, sums);
}

static TARGET void add_distances_in_space(ptrdiff_t step, ptrdiff_t count, const float *__restrict from,
                                          const float *__restrict points, double *__restrict sums) {
    add_distances(SPACE, step, count, from, points, sums);
}

/* Σ_{i < j} ‖u_j − u_i‖ of velocities relative to their mean, in single precision. `room`: n doubles and the points as
 * floats. */
FOR_AXES double sum_of_all(const int axes, ptrdiff_t n, const double *points, double *room) {
    double *sums = room;
    float *single = (float *)(room + n);
    for (ptrdiff_t j = 0; j < n; j++) sums[j] = 0.0;
    for (ptrdiff_t j = 0; j < axes * n; j++) single[j] = (float)points[j];
    for (ptrdiff_t start = 0; start < n; start += BLOCK) {
        const ptrdiff_t end = n - start < BLOCK ? n : start + BLOCK;
        for (ptrdiff_t i = 0; i < end - 1; i++) {
            const ptrdiff_t first = i < start ? start : i + 1;
            (axes == PLANE ? add_distances_in_plane : add_distances_in_space)(n, end - first, single + i, single + first,
                                                                              sums + first);
        }
    }
    return sum_of(sums, n);
}

FOR_AXES double mean_distance(const int axes, ptrdiff_t n, double *points) {
    double *room = points + axes * n;
    if (!n) return 0.0;
    if (n > FEW) {
        for (double *column = points; column < room; column += n) {
            const double mean = sum_of(column, n) / (double)n;
            for (ptrdiff_t j = 0; j < n; j++) column[j] -= mean;
        }
        return 2.0 * sum_of_all(axes, n, points, room) / ((double)n * (double)n);
    }
    for (ptrdiff_t i = 0; i < n; i++)
        (axes == PLANE ? distances_in_plane : distances_in_space)(n, points, i, room + i * n);
    return sum_of(room, n * n) / (double)(n * n);
}

double alignment(int axes, ptrdiff_t n, double *room) { return BY_AXES(axes, mean_distance, n, room); }
