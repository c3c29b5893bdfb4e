/* Compiled form of all_pairs.py: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "axes.h"
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

ptrdiff_t pairs_room(int axes, ptrdiff_t n) { return 2 * axes * n + 4 * axes * (n + TOGETHER) + 4 * n; }

typedef struct { /* columns in the order of the sweep, one for each axis: the box around each segment, and its ends */
    double *low[MOST_AXES], *high[MOST_AXES], *from[MOST_AXES], *to[MOST_AXES];
} Sweep;

static int by_pair(const void *a, const void *b) {
    int64_t pair[2], other[2];
    memcpy(pair, a, sizeof pair), memcpy(other, b, sizeof other); /* they may be unaligned */
    const int k = pair[0] == other[0];
    return (pair[k] > other[k]) - (pair[k] < other[k]);
}

/* Closest approach of two UAVs, from their differences; kernels/state.py: approach. */
FOR_AXES double approach(const int axes, const double *from, const double *to) {
    double step[MOST_AXES], at[MOST_AXES];
    for (int k = 0; k < axes; k++) step[k] = to[k] - from[k];
    const double before = inner(axes, from, step), after = inner(axes, to, step);
    const double ends = smaller(inner(axes, from, from), inner(axes, to, to));
    if (!(before < 0.0 && after > 0.0)) return ends;
    const double share = -before / inner(axes, step, step);
    for (int k = 0; k < axes; k++) at[k] = from[k] + share * step[k];
    return smaller(ends, inner(axes, at, at));
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
FOR_AXES const Place *swept(const int axes, ptrdiff_t n, const double *from, Place *place, const Sweep *sweep,
                            ptrdiff_t *present) {
    const double *to = from + axes * n;
    ptrdiff_t count = 0;
    for (ptrdiff_t uav = 0; uav < n; uav++) {
        int is_here = 1;
        for (int k = 0; k < axes; k++) is_here &= to[k * n + uav] == to[k * n + uav];
        if (is_here) place[count++] = (Place){key(fmin(from[uav], to[uav])), uav};
    }
    place = sorted(count, place, place + n);
    for (ptrdiff_t i = 0; i < count; i++) {
        for (int k = 0; k < axes; k++) {
            const double begin = from[k * n + place[i].uav], end = to[k * n + place[i].uav];
            sweep->from[k][i] = begin, sweep->to[k][i] = end;
            sweep->low[k][i] = fmin(begin, end), sweep->high[k][i] = fmax(begin, end);
        }
    }
    for (ptrdiff_t i = count; i < count + TOGETHER; i++)
        for (int k = 0; k < axes; k++) sweep->low[k][i] = sweep->high[k][i] = INFINITY;
    *present = count;
    return place;
}

/* Squared distance of the boxes of two places in the order. */
FOR_AXES double box(const int axes, const Sweep *s, ptrdiff_t i, ptrdiff_t j) {
    double gap[MOST_AXES] = {larger(s->low[0][j] - s->high[0][i], 0.0)}; /* the sweep is along the first axis */
    for (int k = 1; k < axes; k++)
        gap[k] = larger(larger(s->low[k][j] - s->high[k][i], s->low[k][i] - s->high[k][j]), 0.0);
    return inner(axes, gap, gap);
}

/* Returns whether one of the TOGETHER boxes from the j-th on is within the squared reach of the i-th. */
FOR_AXES int any_close(const int axes, const Sweep *s, ptrdiff_t i, ptrdiff_t j, double reach) {
    int64_t close = 0;
    for (ptrdiff_t k = j; k < j + TOGETHER; k++) close |= box(axes, s, i, k) > reach ? 0 : 1;
    return close != 0;
}

static TARGET int any_close_in_plane(const Sweep *s, ptrdiff_t i, ptrdiff_t j, double reach) {
    return any_close(PLANE, s, i, j, reach);
}

static TARGET int any_close_in_space(const Sweep *s, ptrdiff_t i, ptrdiff_t j, double reach) {
    return any_close(SPACE, s, i, j, reach);
}

FOR_AXES Measured measured(const int axes, ptrdiff_t n, double *room, double hazard, double collision, double nearest,
                           char *found, ptrdiff_t most) {
    const ptrdiff_t length = n + TOGETHER;
    double *at = room + 2 * axes * n;
    Sweep s;
    for (int k = 0; k < axes; k++, at += 4 * length)
        s.low[k] = at, s.high[k] = at + length, s.from[k] = at + 2 * length, s.to[k] = at + 3 * length;
    ptrdiff_t present;
    const Place *place = swept(axes, n, room, (Place *)at, &s, &present);
    Measured seen = {0, 0, nearest * nearest};
    hazard *= hazard, collision *= collision;
    const double radius = larger(hazard, collision);
    for (ptrdiff_t i = 0; i < present; i++) {
        double reach = larger(radius, seen.nearest);
        for (ptrdiff_t first = i + 1; first < present; first += TOGETHER) {
            const double along = larger(s.low[0][first] - s.high[0][i], 0.0);
            if (along * along > reach) break;
            if (!(axes == PLANE ? any_close_in_plane : any_close_in_space)(&s, i, first, reach)) continue;
            const ptrdiff_t end = present - first < TOGETHER ? present : first + TOGETHER;
            for (ptrdiff_t j = first; j < end; j++) {
                const double apart = box(axes, &s, i, j);
                if (apart > reach) continue;
                double from[MOST_AXES], to[MOST_AXES];
                for (int k = 0; k < axes; k++) from[k] = s.from[k][j] - s.from[k][i], to[k] = s.to[k][j] - s.to[k][i];
                const double squared = larger(apart, approach(axes, from, to));
                seen.near += inner(axes, to, to) <= hazard;
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

Measured pairs(int axes, ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found,
               ptrdiff_t most) {
    return BY_AXES(axes, measured, n, room, hazard, collision, nearest, found, most);
}
