/* What kernels/halfplanes.py says: the same operations in the same order. */
#include "halfplanes.h"

#include <math.h>

static const double PARALLEL = 1e-12, EASE = 1e-9, SAME = 1e-16;

typedef struct {
    const double *x, *y, *bound; /* unit normals; who asks for nothing has the bound −∞ */
    ptrdiff_t count;
} Planes;

/* Whether some point keeps them all, each eased by `ease`; `a` is the nearest to `wanted`, or of those before. */
static int project(Planes p, double ease, const double *wanted, double limit, double *a) {
    const double length = sqrt(wanted[0] * wanted[0] + wanted[1] * wanted[1]);
    const double scale = length > limit ? limit / length : 1.0;
    a[0] = wanted[0] * scale, a[1] = wanted[1] * scale;
    for (ptrdiff_t k = 0; k < p.count; k++) {
        const double x = p.x[k], y = p.y[k], b = p.bound[k] - ease;
        if (!(x * a[0] + y * a[1] < b)) continue;
        const double room = limit * limit - b * b;
        if (!(room >= 0.0)) return 0;
        double high = sqrt(room > 0.0 ? room : 0.0), low = -high;
        for (ptrdiff_t j = 0; j < k; j++) {
            const double sine = x * p.y[j] - y * p.x[j];
            const double cosine = x * p.x[j] + y * p.y[j], asked = (p.bound[j] - ease) - b * cosine;
            if (fabs(sine) <= PARALLEL) { /* one that looks the same way is kept already */
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

/* Two of them and the disc. */
static double needed_of_two(Planes p, ptrdiff_t i, ptrdiff_t j, double limit) {
    const double m_x = p.x[i] - p.x[j], m_y = p.y[i] - p.y[j], apart = p.bound[i] - p.bound[j];
    const double squared = m_x * m_x + m_y * m_y, cosine = p.x[i] * p.x[j] + p.y[i] * p.y[j];
    const int both = p.bound[j] - limit * cosine > p.bound[i] - limit && p.bound[i] - limit * cosine > p.bound[j] - limit;
    if (!both || !(squared > SAME)) return 0.0;
    const double room = limit * limit - apart * apart / squared;
    const double reached = (p.x[i] * m_x + p.y[i] * m_y) * (apart / squared)
        + fabs(p.y[i] * m_x - p.x[i] * m_y) * sqrt((room > 0.0 ? room : 0.0) / squared);
    return p.bound[i] - reached;
}

/* Three of them. */
static double needed_of_three(Planes p, ptrdiff_t i, ptrdiff_t j, ptrdiff_t k) {
    const double a = p.x[j] * p.y[k] - p.y[j] * p.x[k];
    const double b = p.x[k] * p.y[i] - p.y[k] * p.x[i];
    const double c = p.x[i] * p.y[j] - p.y[i] * p.x[j];
    const double total = a + b + c;
    if (!((a >= 0.0 && b >= 0.0 && c >= 0.0) || (a <= 0.0 && b <= 0.0 && c <= 0.0))) return 0.0;
    if (!(fabs(total) > PARALLEL)) return 0.0;
    return (a * p.bound[i] + b * p.bound[j] + c * p.bound[k]) / total;
}

/* The least by which all must be eased. */
static double needed(Planes p, double limit) {
    double most = 0.0, one;
    for (ptrdiff_t i = 0; i < p.count; i++) {
        if ((one = p.bound[i] - limit) > most) most = one;
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
    double *x = room, *y = x + count, *bound = y + count, need = 0.0;
    for (ptrdiff_t k = 0; k < count; k++) {
        const double *n = normals + 2 * k, length = sqrt(n[0] * n[0] + n[1] * n[1]);
        x[k] = n[0] / length, y[k] = n[1] / length, bound[k] = bounds[k] / length;
        if (!isfinite(x[k]) || !isfinite(y[k]) || !isfinite(bound[k])) x[k] = y[k] = 0.0, bound[k] = -INFINITY;
    }
    const Planes planes = {x, y, bound, count};
    if (!project(planes, 0.0, wanted, limit, a)) {
        need = needed(planes, limit);
        project(planes, need + EASE * (1.0 + need), wanted, limit, a);
    }
    if (!isfinite(wanted[0]) || !isfinite(wanted[1])) a[0] = a[1] = NAN;
    return need;
}
