/* Compiled form of kernels/halfplanes.py: the same operations in the same order. */
#include "native.h"

#include <math.h>

static const double PARALLEL = 1e-12, EASE = 1e-9, SAME = 1e-16;

int project(Planes p, double ease, const double *wanted, double limit, double *a) {
    const double length = sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1]);
    const double scale = length > limit ? limit / length : 1.0;
    a[0] = wanted[0] * scale, a[1] = wanted[1] * scale;
    for (ptrdiff_t k = 0; k < p.count; k++) {
        const double x = p.x[k], y = p.y[k], b = p.bound[k] - ease / p.length[k];
        if (!(x * a[0] + y * a[1] < b)) continue;
        const double room = limit * limit - b * b;
        if (!(room >= 0.0)) return 0;
        double high = sqrt(room > 0.0 ? room : 0.0), low = -high;
        for (ptrdiff_t j = 0; j < k; j++) {
            const double sine = x * p.y[j] - y * p.x[j];
            const double cosine = x * p.x[j] + y * p.y[j], asked = (p.bound[j] - ease / p.length[j]) - b * cosine;
            if (fabs(sine) <= PARALLEL) { /* a parallel one is satisfied already */
                if (cosine < 0.0 && asked > 0.0) return 0;
                continue;
            }
            const double at = asked / sine;
            if (sine > 0.0) low = at > low ? at : low;
            else high = at < high ? at : high;
        }
        if (!(low <= high)) return 0;
        double s = x * wanted[1] - y * wanted[0];
        s = s > low ? s : low, s = (s < high ? s : high) + 0.0;
        a[0] = x * b - y * s, a[1] = y * b + x * s;
    }
    return 1;
}

/* The corner of two half-planes with given normals and the disc. */
static double needed_of_two(Planes p, ptrdiff_t i, ptrdiff_t j, double limit) {
    const double m_x = p.x[i] - p.x[j], m_y = p.y[i] - p.y[j], apart = p.bound[i] - p.bound[j];
    const double squared = m_x * m_x + m_y * m_y, inner = p.x[i] * p.x[j] + p.y[i] * p.y[j];
    const double l_i = p.length[i], l_j = p.length[j];
    if (!(p.bound[j] - limit * inner / l_i > p.bound[i] - limit * l_i)) return 0.0;
    if (!(p.bound[i] - limit * inner / l_j > p.bound[j] - limit * l_j)) return 0.0;
    if (!(squared > SAME * (l_i * l_j))) return 0.0;
    const double room = limit * limit - apart * apart / squared;
    const double reached = (p.x[i] * m_x + p.y[i] * m_y) * (apart / squared)
        + fabs(p.y[i] * m_x - p.x[i] * m_y) * sqrt((room > 0.0 ? room : 0.0) / squared);
    return p.bound[i] - reached;
}

/* The corner of three half-planes. */
static double needed_of_three(Planes p, ptrdiff_t i, ptrdiff_t j, ptrdiff_t k) {
    const double a = p.x[j] * p.y[k] - p.y[j] * p.x[k];
    const double b = p.x[k] * p.y[i] - p.y[k] * p.x[i];
    const double c = p.x[i] * p.y[j] - p.y[i] * p.x[j];
    const double total = a + b + c;
    const double of_lengths =
        p.length[j] * p.length[k] + p.length[k] * p.length[i] + p.length[i] * p.length[j];
    if (!((a >= 0.0 && b >= 0.0 && c >= 0.0) || (a <= 0.0 && b <= 0.0 && c <= 0.0))) return 0.0;
    if (!(fabs(total) > PARALLEL * of_lengths)) return 0.0;
    return (a * p.bound[i] + b * p.bound[j] + c * p.bound[k]) / total;
}

/* Least easing with which a point satisfies all half-planes. */
static double needed(Planes p, double limit) {
    double most = 0.0, one;
    for (ptrdiff_t i = 0; i < p.count; i++) {
        if ((one = p.bound[i] - limit * p.length[i]) > most) most = one;
        for (ptrdiff_t j = i + 1; j < p.count; j++) {
            if ((one = needed_of_two(p, i, j, limit)) > most) most = one;
            for (ptrdiff_t k = j + 1; k < p.count; k++)
                if ((one = needed_of_three(p, i, j, k)) > most) most = one;
        }
    }
    return most;
}

double nearest(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
               double *room, double *a) {
    double *x = room, *y = x + count, *bound = y + count, *lengths = bound + count, need = 0.0;
    for (ptrdiff_t k = 0; k < count; k++) {
        const double *n = normals + 2 * k, length = sqrt(n[0] * n[0] + n[1] * n[1]);
        x[k] = n[0] / length, y[k] = n[1] / length, bound[k] = bounds[k] / length;
        lengths[k] = length;
        if (isfinite(length) && isfinite(x[k]) && isfinite(y[k]) && isfinite(bound[k])) continue;
        x[k] = y[k] = 0.0, bound[k] = -INFINITY, lengths[k] = 1.0;
    }
    const Planes planes = {x, y, bound, lengths, count};
    if (!project(planes, 0.0, wanted, limit, a)) {
        double *long_x = lengths + count, *long_y = long_x + count, *long_bound = long_y + count;
        for (ptrdiff_t k = 0; k < count; k++) {
            long_x[k] = x[k] * lengths[k], long_y[k] = y[k] * lengths[k], long_bound[k] = bound[k] * lengths[k];
        }
        need = needed((Planes){long_x, long_y, long_bound, lengths, count}, limit);
        project(planes, need + EASE * (1.0 + need), wanted, limit, a);
    }
    if (!isfinite(wanted[0]) || !isfinite(wanted[1])) a[0] = a[1] = NAN;
    return need;
}
