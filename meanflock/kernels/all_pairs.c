/* Compiled form of all_pairs.py: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "pairwise.h"

enum { TOGETHER = 16 }; /* boxes that are compared at once; any number gives the same result */

/* The smaller of two numbers; NaN if one of them is. */
static double smaller(double a, double b) { return a < b || a != a ? a : b; }

/* The larger of two numbers; NaN if the second is NaN. */
static double larger(double a, double b) { return a > b ? a : b; }

enum { DIGIT = 8, DIGITS = 1 << DIGIT, KEY = 64 }; /* bits of a digit, by which places are sorted; values; all bits */

typedef struct { /* a UAV in the order of the sweep; the order of the keys is that of low_x */
    uint64_t key;
    int64_t uav;
} Place;

ptrdiff_t pairs_room(ptrdiff_t n) { return 4 * n + 8 * (n + TOGETHER) + 4 * n; }

typedef struct { /* columns in that order: the box around each segment, and its ends */
    double *low_x, *high_x, *low_y, *high_y, *x, *y, *to_x, *to_y;
} Sweep;

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

/* Sorts places by their keys, digit by digit; returns `place` or `other`, whichever has the result. */
static Place *sorted(ptrdiff_t n, Place *place, Place *other) {
    for (int shift = 0; shift < KEY; shift += DIGIT) {
        ptrdiff_t starts[DIGITS + 1] = {0};
        for (ptrdiff_t i = 0; i < n; i++) starts[(place[i].key >> shift) % DIGITS + 1]++;
        for (int digit = 1; digit < DIGITS; digit++) starts[digit] += starts[digit - 1];
        for (ptrdiff_t i = 0; i < n; i++) other[starts[(place[i].key >> shift) % DIGITS]++] = place[i];
        Place *last = place;
        place = other, other = last;
    }
    return place;
}

/* Key of a number: keys of unsigned integers have the order of the numbers. */
static uint64_t key(double number) {
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits >> (KEY - 1) ? ~bits : bits | (uint64_t)1 << (KEY - 1);
}

/* Orders the UAVs whose position at the end of the tick is finite; their number goes to `present`. */
static const Place *swept(ptrdiff_t n, const double *x, Place *place, const Sweep *sweep, ptrdiff_t *present) {
    const double *y = x + n, *to_x = y + n, *to_y = to_x + n;
    ptrdiff_t count = 0;
    for (ptrdiff_t uav = 0; uav < n; uav++)
        if (to_x[uav] == to_x[uav] && to_y[uav] == to_y[uav]) place[count++] = (Place){key(fmin(x[uav], to_x[uav])), uav};
    place = sorted(count, place, place + n);
    for (ptrdiff_t i = 0; i < count; i++) {
        const ptrdiff_t uav = place[i].uav;
        sweep->x[i] = x[uav], sweep->y[i] = y[uav], sweep->to_x[i] = to_x[uav], sweep->to_y[i] = to_y[uav];
        sweep->low_x[i] = fmin(x[uav], to_x[uav]), sweep->high_x[i] = fmax(x[uav], to_x[uav]);
        sweep->low_y[i] = fmin(y[uav], to_y[uav]), sweep->high_y[i] = fmax(y[uav], to_y[uav]);
    }
    for (ptrdiff_t i = count; i < count + TOGETHER; i++) sweep->low_x[i] = sweep->low_y[i] = sweep->high_y[i] = INFINITY;
    *present = count;
    return place;
}

/* Squared distance of the boxes of two places in the order. */
INLINE double box(const Sweep *s, ptrdiff_t i, ptrdiff_t j) {
    const double along = larger(s->low_x[j] - s->high_x[i], 0.0);
    const double across = larger(larger(s->low_y[j] - s->high_y[i], s->low_y[i] - s->high_y[j]), 0.0);
    return along * along + across * across;
}

/* Returns whether one of the TOGETHER boxes from the j-th on is within the squared reach of the i-th. */
static TARGET int any_close(const Sweep *s, ptrdiff_t i, ptrdiff_t j, double reach) {
    int64_t close = 0;
    for (ptrdiff_t k = j; k < j + TOGETHER; k++) close |= box(s, i, k) > reach ? 0 : 1;
    return close != 0;
}

Measured pairs(ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found, ptrdiff_t most) {
    const ptrdiff_t length = n + TOGETHER;
    double *at = room + 4 * n;
    const Sweep s = {at, at + length, at + 2 * length, at + 3 * length, at + 4 * length, at + 5 * length, at + 6 * length,
                     at + 7 * length};
    ptrdiff_t present;
    const Place *place = swept(n, room, (Place *)(at + 8 * length), &s, &present);
    Measured seen = {0, 0, nearest * nearest};
    hazard *= hazard, collision *= collision;
    const double radius = larger(hazard, collision);
    for (ptrdiff_t i = 0; i < present; i++) {
        double reach = larger(radius, seen.nearest);
        for (ptrdiff_t first = i + 1; first < present; first += TOGETHER) {
            const double along = larger(s.low_x[first] - s.high_x[i], 0.0);
            if (along * along > reach) break;
            if (!any_close(&s, i, first, reach)) continue;
            const ptrdiff_t end = present - first < TOGETHER ? present : first + TOGETHER;
            for (ptrdiff_t j = first; j < end; j++) {
                const double apart = box(&s, i, j);
                if (apart > reach) continue;
                const double to_x = s.to_x[j] - s.to_x[i], to_y = s.to_y[j] - s.to_y[i];
                const double squared = larger(apart, approach(s.x[j] - s.x[i], s.y[j] - s.y[i], to_x, to_y));
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
    }
    qsort(found, seen.touching < most ? seen.touching : most, 2 * sizeof(int64_t), by_pair);
    seen.nearest = sqrt(seen.nearest);
    return seen;
}
