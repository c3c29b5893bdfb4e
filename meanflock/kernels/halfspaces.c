/* Compiled form of kernels/halfspaces.py: the same operations in the same order. */
#include "native.h"

#include <math.h>

#include "axes.h"

static const double PARALLEL = 1e-12, EASE = 1e-9;
enum { HALVINGS = 52 }; /* of the bisection, as in halfspaces.py */

typedef struct {
    const double *unit, *bound, *length; /* (count, 3), (count), (count); an unused half-space has the bound −∞ */
    double *x, *y, *asked, *ones;        /* room for the half-planes in the face of a half-space */
    ptrdiff_t count;
} Spaces;

static double dot(const double *a, const double *b) { return inner(SPACE, a, b); }

/* As `project`, of half-spaces and a ball. */
static int project_in_space(const Spaces *s, double ease, const double *wanted, double limit, double *a) {
    const double length = sqrt(dot(wanted, wanted)), scale = length > limit ? limit / length : 1.0;
    for (int axis = 0; axis < SPACE; axis++) a[axis] = wanted[axis] * scale;
    for (ptrdiff_t k = 0; k < s->count; k++) {
        const double *n = s->unit + SPACE * k, b = s->bound[k] - ease / s->length[k];
        if (!(dot(n, a) < b)) continue;
        const double room = limit * limit - b * b;
        if (!(room >= 0.0)) return 0;
        const double sign = n[2] >= 0.0 ? 1.0 : -1.0, across = -1.0 / (sign + n[2]), both = n[0] * n[1] * across;
        const double e[] = {1.0 + sign * n[0] * n[0] * across, sign * both, -sign * n[0]};
        const double f[] = {both, sign + n[1] * n[1] * across, -n[1]};
        for (ptrdiff_t j = 0; j < k; j++) {
            const double *o = s->unit + SPACE * j, cosine = dot(n, o);
            const double asked = (s->bound[j] - ease / s->length[j]) - b * cosine;
            const double m_x = dot(e, o), m_y = dot(f, o), sine = sqrt(m_x * m_x + m_y * m_y);
            if (sine <= PARALLEL) { /* a parallel one is satisfied already */
                if (cosine < 0.0 && asked > 0.0) return 0;
                s->x[j] = s->y[j] = 0.0, s->asked[j] = -INFINITY;
                continue;
            }
            s->x[j] = m_x / sine, s->y[j] = m_y / sine, s->asked[j] = asked / sine;
        }
        const double in_face[] = {dot(wanted, e), dot(wanted, f)};
        const Planes planes = {s->x, s->y, s->asked, s->ones, k};
        double at[PLANE];
        if (!project(planes, 0.0, in_face, sqrt(room > 0.0 ? room : 0.0), at)) return 0;
        for (int axis = 0; axis < SPACE; axis++) a[axis] = n[axis] * b + (e[axis] * at[0] + f[axis] * at[1]);
    }
    return 1;
}

/* Least easing with which a point satisfies all half-spaces. */
static double needed(const Spaces *s, const double *wanted, double limit) {
    double low = 0.0, high = 0.0, one, a[SPACE];
    for (ptrdiff_t k = 0; k < s->count; k++) {
        if ((one = s->bound[k] * s->length[k] - limit * s->length[k]) > low) low = one;
        if ((one = s->bound[k] * s->length[k]) > high) high = one;
    }
    if (low > high) high = low;
    for (int i = 0; i < HALVINGS; i++) {
        const double middle = 0.5 * (low + high);
        if (project_in_space(s, middle, wanted, limit, a)) high = middle;
        else low = middle;
    }
    return high;
}

double nearest_in_space(const double *wanted, const double *normals, const double *bounds, ptrdiff_t count, double limit,
                        double *room, double *a) {
    double *unit = room, *bound = unit + SPACE * count, *length = bound + count, need = 0.0;
    double *x = length + count, *y = x + count, *asked = y + count, *ones = asked + count;
    for (ptrdiff_t k = 0; k < count; k++) {
        const double *n = normals + SPACE * k, norm = sqrt(dot(n, n));
        double *u = unit + SPACE * k;
        u[0] = n[0] / norm, u[1] = n[1] / norm, u[2] = n[2] / norm, bound[k] = bounds[k] / norm, length[k] = norm;
        ones[k] = 1.0;
        if (isfinite(norm) && isfinite(u[0]) && isfinite(u[1]) && isfinite(u[2]) && isfinite(bound[k])) continue;
        u[0] = u[1] = u[2] = 0.0, bound[k] = -INFINITY, length[k] = 1.0;
    }
    const Spaces spaces = {unit, bound, length, x, y, asked, ones, count};
    if (!project_in_space(&spaces, 0.0, wanted, limit, a)) {
        need = needed(&spaces, wanted, limit);
        project_in_space(&spaces, need + EASE * (1.0 + need), wanted, limit, a);
    }
    if (!isfinite(wanted[0]) || !isfinite(wanted[1]) || !isfinite(wanted[2])) a[0] = a[1] = a[2] = NAN;
    return need;
}
