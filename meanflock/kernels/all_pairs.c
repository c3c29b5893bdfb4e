/* Compiled form of all_pairs.py: the same operations in the same order. */
#define LANES 1
#include "native.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "axes.h"
#include "pairwise.h"

enum { MANY = 4096 };             /* UAVs above which the sweep goes by strips */
enum { LEVELS = 8, LONGER = 8 }; /* levels of the extents of segments; each has extents so many times as long */
static const double MARGIN = 1.0 + 1e-6; /* more than rounding errors, by which no pair may be missed */
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

ptrdiff_t pairs_room(int axes, ptrdiff_t n) { return 2 * axes * n + 4 * axes * (n + TOGETHER) + 4 * n + n + 2 * LEVELS; }

typedef struct { /* columns in the order of the sweeps, one for each axis: the box around each segment, and its ends */
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

/* Sorts places by their keys, digit by digit. `other` has room for as many; the number of digits is even. */
static void sort(ptrdiff_t n, Place *place, Place *other) {
    for (int shift = 0; shift < KEY; shift += DIGIT) {
        ptrdiff_t starts[DIGITS + 1] = {0};
        for (ptrdiff_t i = 0; i < n; i++) starts[(place[i].key >> shift) % DIGITS + 1]++;
        for (int digit = 1; digit < DIGITS; digit++) starts[digit] += starts[digit - 1];
        for (ptrdiff_t i = 0; i < n; i++) other[starts[(place[i].key >> shift) % DIGITS]++] = place[i];
        Place *last = place;
        place = other, other = last;
    }
}

/* Key of a number: keys of unsigned integers have the order of the numbers. */
static uint64_t key(double number) {
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    return bits >> (KEY - 1) ? ~bits : bits | (uint64_t)1 << (KEY - 1);
}

/* Orders the UAVs whose position at the end of the tick is finite by the least x of their segments; returns how many. */
FOR_AXES ptrdiff_t order_by_x(const int axes, ptrdiff_t n, const double *from, Place *place) {
    const double *to = from + axes * n;
    ptrdiff_t count = 0;
    for (ptrdiff_t uav = 0; uav < n; uav++) {
        int is_here = 1;
        for (int k = 0; k < axes; k++) is_here &= to[k * n + uav] == to[k * n + uav];
        if (is_here) place[count++] = (Place){key(fmin(from[uav], to[uav])), uav};
    }
    sort(count, place, place + n);
    return count;
}

/* Copies the segments of places, in their order, and the boxes around them. */
FOR_AXES void line_up(const int axes, ptrdiff_t n, ptrdiff_t count, const double *from, const Place *place, Sweep *sweep) {
    const double *to = from + axes * n;
    for (ptrdiff_t i = 0; i < count; i++) {
        for (int k = 0; k < axes; k++) {
            const double begin = from[k * n + place[i].uav], end = to[k * n + place[i].uav];
            sweep->from[k][i] = begin, sweep->to[k][i] = end;
            sweep->low[k][i] = fmin(begin, end), sweep->high[k][i] = fmax(begin, end);
        }
    }
    for (ptrdiff_t i = count; i < count + TOGETHER; i++)
        for (int k = 0; k < axes; k++) sweep->low[k][i] = sweep->high[k][i] = INFINITY;
}

/* Squared distance of the boxes of two places in the order. */
FOR_AXES double box(const int axes, const Sweep *s, ptrdiff_t i, ptrdiff_t j) {
    double gap[MOST_AXES];
    for (int k = 0; k < axes; k++)
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

/* Squared closest approach of two places in the order, whose boxes are `apart`. */
FOR_AXES double closest(const int axes, const Sweep *s, ptrdiff_t i, ptrdiff_t j, double apart) {
    double from[MOST_AXES], to[MOST_AXES];
    for (int k = 0; k < axes; k++) from[k] = s->from[k][j] - s->from[k][i], to[k] = s->to[k][j] - s->to[k][i];
    return larger(apart, approach(axes, from, to));
}

typedef struct { /* UAVs whose segments have a like extent: places in the order, by strips along x */
    ptrdiff_t first, end, strips;
    ptrdiff_t *begin;             /* where each strip begins, and the end of the last */
    double low, width;            /* least y, and the width of a strip */
    double along, across;         /* largest extents along x and y */
} Level;

/* Level of the box of a place, by its extent. */
static int level_of(const Sweep *s, ptrdiff_t i, double reach) {
    const double extent = larger(s->high[0][i] - s->low[0][i], s->high[1][i] - s->low[1][i]);
    int level = 0;
    for (double most = LONGER * reach; level + 1 < LEVELS && extent > most; most *= LONGER) level++;
    return level;
}

/* Sorts places, which are in the order of x, by levels. */
static void sort_by_levels(ptrdiff_t count, const Sweep *s, double reach, Place *place, Place *other, Level *levels) {
    ptrdiff_t next[LEVELS] = {0}, end = 0;
    for (ptrdiff_t i = 0; i < count; i++) next[level_of(s, i, reach)]++;
    for (int k = 0; k < LEVELS; k++) {
        levels[k].first = end, end += next[k], levels[k].end = end;
        next[k] = levels[k].first;
    }
    memcpy(other, place, count * sizeof *place);
    for (ptrdiff_t i = 0; i < count; i++) place[next[level_of(s, i, reach)]++] = other[i];
}

/* Strip of a level in which a number along y lies, or the nearest one. */
static ptrdiff_t strip_of(const Level *level, double y) {
    const double strip = (y - level->low) / level->width, last = (double)(level->strips - 1);
    return strip > 0.0 ? (ptrdiff_t)smaller(strip, last) : 0;
}

/* Sorts the places of a level, which are in the order of x, by strips that are as wide as `reach` and a box, or wider. */
static void sort_by_strips(const Sweep *s, double reach, Place *place, Place *other, Level *level) {
    const ptrdiff_t first = level->first, end = level->end;
    ptrdiff_t *begin = level->begin;
    double low = INFINITY, high = -INFINITY;
    level->along = level->across = 0.0;
    for (ptrdiff_t i = first; i < end; i++) {
        low = smaller(s->low[1][i], low), high = larger(s->low[1][i], high);
        level->along = larger(s->high[0][i] - s->low[0][i], level->along);
        level->across = larger(s->high[1][i] - s->low[1][i], level->across);
    }
    level->low = low, level->width = larger((reach + level->across) * MARGIN, (high - low) / (double)(end - first));
    const ptrdiff_t strips = level->strips = (ptrdiff_t)((high - low) / level->width) + 1;
    memset(begin, 0, (strips + 1) * sizeof *begin);
    for (ptrdiff_t i = first; i < end; i++) begin[strip_of(level, s->low[1][i]) + 1]++;
    begin[0] = first;
    for (ptrdiff_t strip = 0; strip < strips; strip++) begin[strip + 1] += begin[strip];
    memcpy(other, place + first, (end - first) * sizeof *place);
    for (ptrdiff_t i = end - 1; i >= first; i--) place[--begin[strip_of(level, s->low[1][i]) + 1]] = other[i - first];
    for (ptrdiff_t strip = 0; strip < strips; strip++) begin[strip] = begin[strip + 1];
    begin[strips] = end;
}

typedef struct { /* what was found, and what is looked for in which order */
    Measured seen; /* `nearest` is squared */
    double radius, hazard, collision; /* squared */
    const Sweep *sweep;
    const Place *place;
    char *found;
    ptrdiff_t most;
} Search;

/* Compares a place in the order with those from `first` to `last`, as long as they are within reach along x. */
FOR_AXES void compare(const int axes, Search *search, ptrdiff_t i, ptrdiff_t first, ptrdiff_t last) {
    const Sweep *s = search->sweep;
    Measured *seen = &search->seen;
    double reach = larger(search->radius, seen->nearest);
    for (; first < last; first += TOGETHER) {
        const double along = larger(s->low[0][first] - s->high[0][i], 0.0);
        if (along * along > reach) break;
        if (!(axes == PLANE ? any_close_in_plane : any_close_in_space)(s, i, first, reach)) continue;
        const ptrdiff_t end = last - first < TOGETHER ? last : first + TOGETHER;
        for (ptrdiff_t j = first; j < end; j++) {
            const double apart = box(axes, s, i, j);
            if (apart > reach) continue;
            const double squared = closest(axes, s, i, j, apart);
            double to[MOST_AXES];
            for (int k = 0; k < axes; k++) to[k] = s->to[k][j] - s->to[k][i];
            seen->near += inner(axes, to, to) <= search->hazard;
            if (squared < seen->nearest) {
                seen->nearest = squared;
                reach = larger(search->radius, squared);
            }
            if (!(squared < search->collision)) continue;
            const int64_t one = search->place[i].uav, other = search->place[j].uav;
            const int64_t pair[] = {one < other ? one : other, one < other ? other : one};
            char *to_write = search->found + seen->touching * (ptrdiff_t)sizeof pair;
            if (seen->touching < search->most) memcpy(to_write, pair, sizeof pair);
            seen->touching++;
        }
    }
}

/* How far pairs are looked for. */
static double reach_of(const Search *search) { return sqrt(larger(search->radius, search->seen.nearest)); }

/* Compares the places of a level with each other: those of a strip, and those of the next one. */
FOR_AXES void compare_within(const int axes, Search *search, const Level *level) {
    const double *low = search->sweep->low[0];
    for (ptrdiff_t strip = 0; strip < level->strips; strip++) {
        const ptrdiff_t end = level->begin[strip + 1];
        const ptrdiff_t stop = strip + 1 < level->strips ? level->begin[strip + 2] : end;
        ptrdiff_t next = end; /* the first place of the next strip that may be within reach */
        for (ptrdiff_t i = level->begin[strip]; i < end; i++) {
            compare(axes, search, i, i + 1, end);
            const double reach = (reach_of(search) + level->along) * MARGIN;
            while (next < stop && low[i] - low[next] > reach) next++;
            compare(axes, search, i, next, stop);
        }
    }
}

/* Compares a place with those of a level of longer segments. */
FOR_AXES void compare_with(const int axes, Search *search, ptrdiff_t i, const Level *level) {
    const Sweep *s = search->sweep;
    const double reach = reach_of(search), least = s->low[0][i] - (reach + level->along) * MARGIN;
    const ptrdiff_t last = strip_of(level, s->high[1][i] + reach * MARGIN);
    for (ptrdiff_t strip = strip_of(level, s->low[1][i] - (reach + level->across) * MARGIN); strip <= last; strip++) {
        const ptrdiff_t end = level->begin[strip + 1];
        ptrdiff_t first = level->begin[strip], left = end - first; /* the first place that may be within reach */
        while (left > 0) {
            const ptrdiff_t half = left / 2;
            if (s->low[0][first + half] < least) first += half + 1, left -= half + 1;
            else left = half;
        }
        compare(axes, search, i, first, end);
    }
}

FOR_AXES Measured measured(const int axes, ptrdiff_t n, double *room, double hazard, double collision, double nearest,
                           char *found, ptrdiff_t most) {
    const ptrdiff_t length = n + TOGETHER;
    double *at = room + 2 * axes * n;
    Sweep s;
    for (int k = 0; k < axes; k++, at += 4 * length)
        s.low[k] = at, s.high[k] = at + length, s.from[k] = at + 2 * length, s.to[k] = at + 3 * length;
    Place *place = (Place *)at;
    const ptrdiff_t present = order_by_x(axes, n, room, place);
    line_up(axes, n, present, room, place, &s);
    hazard *= hazard, collision *= collision;
    Search search = {{0, 0, nearest * nearest}, larger(hazard, collision), hazard, collision, &s, place, found, most};
    ptrdiff_t *begin = (ptrdiff_t *)(place + 2 * n);
    Level levels[LEVELS] = {{0, present, 1, begin, 0.0, 0.0, 0.0, 0.0}};
    begin[0] = 0, begin[1] = present;
    if (present > MANY) {
        for (ptrdiff_t i = 0; i + 1 < present; i++) { /* some distances: strips are as wide as the least of them */
            const double some = closest(axes, &s, i, i + 1, box(axes, &s, i, i + 1));
            if (some < search.seen.nearest) search.seen.nearest = some;
        }
        const double reach = reach_of(&search);
        sort_by_levels(present, &s, reach, place, place + n, levels);
        if (levels[0].end < present) line_up(axes, n, present, room, place, &s);
        for (Level *level = levels; level < levels + LEVELS; level++) {
            level->begin = begin, level->strips = 0;
            if (level->first < level->end) sort_by_strips(&s, reach, place, place + n, level);
            begin += level->end - level->first + 2;
        }
        line_up(axes, n, present, room, place, &s);
    }
    for (const Level *level = levels; level < levels + LEVELS; level++) {
        compare_within(axes, &search, level);
        for (const Level *other = level + 1; other < levels + LEVELS; other++)
            for (ptrdiff_t i = level->first; other->first < other->end && i < level->end; i++)
                compare_with(axes, &search, i, other);
    }
    qsort(found, search.seen.touching < most ? search.seen.touching : most, 2 * sizeof(int64_t), by_pair);
    search.seen.nearest = sqrt(search.seen.nearest);
    return search.seen;
}

Measured pairs(int axes, ptrdiff_t n, double *room, double hazard, double collision, double nearest, char *found,
               ptrdiff_t most) {
    return BY_AXES(axes, measured, n, room, hazard, collision, nearest, found, most);
}
