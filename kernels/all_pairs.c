/* Compiled form of all_pairs.py: the same operations in the same order. */
#include "native.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* The smaller of two numbers; NaN if one of them is. */
static double smaller(double a, double b) { return a < b || a != a ? a : b; }

/* The larger of two numbers; NaN if the second is NaN. */
static double larger(double a, double b) { return a > b ? a : b; }

ptrdiff_t pairs_room(ptrdiff_t n) { return 14 * n; }

typedef struct { /* a UAV in the order of the sweep */
    double low_x;
    int64_t uav;
} Place;

typedef struct { /* columns in that order: the box around each segment, and its ends */
    double *low_x, *high_x, *low_y, *high_y, *x, *y, *to_x, *to_y;
} Sweep;

static int by_low(const void *a, const void *b) {
    const double low = ((const Place *)a)->low_x, other = ((const Place *)b)->low_x;
    return (low > other) - (low < other);
}

static int by_pair(const void *a, const void *b) {
    int64_t pair[2], other[2];
    memcpy(pair, a, sizeof pair), memcpy(other, b, sizeof other); /* they may be unaligned */
    const int k = pair[0] == other[0];
    return (pair[k] > other[k]) - (pair[k] < other[k]);
}

/* Closest approach of two UAVs, from their differences; kernels/state.py: approach. */
static double approach(double x, double y, double to_x, double to_y) {
    const double step_x = to_x - x, step_y = to_y - y, before = x * step_x + y * step_y, after = to_x * step_x + to_y * step_y;
    const double ends = smaller(x * x + y * y, to_x * to_x + to_y * to_y);
    if (!(before < 0.0 && after > 0.0)) return ends;
    const double share = -before / (step_x * step_x + step_y * step_y);
    const double at_x = x + share * step_x, at_y = y + share * step_y;
    return smaller(ends, at_x * at_x + at_y * at_y);
}

/* Sorts the UAVs whose position at the end of the tick is finite; returns their number. */
static ptrdiff_t sorted(ptrdiff_t n, const double *x, Place *place, const Sweep *sweep) {
    const double *y = x + n, *to_x = y + n, *to_y = to_x + n;
    ptrdiff_t present = 0;
    for (ptrdiff_t uav = 0; uav < n; uav++)
        if (to_x[uav] == to_x[uav] && to_y[uav] == to_y[uav]) place[present++] = (Place){fmin(x[uav], to_x[uav]), uav};
    qsort(place, present, sizeof *place, by_low);
    for (ptrdiff_t i = 0; i < present; i++) {
        const ptrdiff_t uav = place[i].uav;
        sweep->x[i] = x[uav], sweep->y[i] = y[uav], sweep->to_x[i] = to_x[uav], sweep->to_y[i] = to_y[uav];
        sweep->low_x[i] = place[i].low_x, sweep->high_x[i] = fmax(x[uav], to_x[uav]);
        sweep->low_y[i] = fmin(y[uav], to_y[uav]), sweep->high_y[i] = fmax(y[uav], to_y[uav]);
    }
    return present;
}

Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found, ptrdiff_t most) {
    double *at = room + 4 * n;
    Place *place = (Place *)(room + 12 * n);
    const Sweep s = {at, at + n, at + 2 * n, at + 3 * n, at + 4 * n, at + 5 * n, at + 6 * n, at + 7 * n};
    const ptrdiff_t present = sorted(n, room, place, &s);
    Measured seen = {0, 0, nearest * nearest};
    hazard *= hazard, collision *= collision;
    const double radius = larger(hazard, collision);
    for (ptrdiff_t i = 0; i < present; i++) {
        const double right = s.high_x[i], top = s.high_y[i], bottom = s.low_y[i];
        double reach = larger(radius, seen.nearest);
        for (ptrdiff_t j = i + 1; j < present; j++) {
            const double along = larger(s.low_x[j] - right, 0.0), squared_along = along * along;
            if (squared_along > reach) break;
            const double across = larger(larger(s.low_y[j] - top, bottom - s.high_y[j]), 0.0);
            const double box = squared_along + across * across;
            if (box > reach) continue;
            const double to_x = s.to_x[j] - s.to_x[i], to_y = s.to_y[j] - s.to_y[i];
            const double squared = larger(box, approach(s.x[j] - s.x[i], s.y[j] - s.y[i], to_x, to_y));
            seen.near += to_x * to_x + to_y * to_y <= hazard;
            if (squared < seen.nearest) {
                seen.nearest = squared;
                reach = larger(radius, squared);
            }
            if (!(squared < collision)) continue;
            const int64_t one = place[i].uav, other = place[j].uav;
            const int64_t pair[] = {one < other ? one : other, one < other ? other : one};
            if (seen.touching < most) memcpy(found + seen.touching * (ptrdiff_t)sizeof pair, pair, sizeof pair);
            seen.touching++;
        }
    }
    qsort(found, seen.touching < most ? seen.touching : most, 2 * sizeof(int64_t), by_pair);
    seen.nearest = sqrt(seen.nearest);
    return seen;
}
