/* Compiled form of ranking.py. */
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "axes.h"

static const double NEVER_NEARER_M = 1e-3;

/* Puts the numbers of the nearest objects of a row of n into `found`, at most `most`; returns how many there are. */
static Py_ssize_t nearest_first(const char *distance, Py_ssize_t n, double reach, Py_ssize_t most, double *near,
                                int64_t *found) {
    Py_ssize_t count = 0;
    for (Py_ssize_t j = 0; j < n; j++) {
        const double apart = double_at(distance, j);
        if (!(apart <= reach) || (count == most && !(most && apart < near[most - 1]))) continue;
        Py_ssize_t at = count < most ? count++ : most - 1;
        for (; at > 0 && apart < near[at - 1]; at--) near[at] = near[at - 1], found[at] = found[at - 1];
        near[at] = apart, found[at] = j;
    }
    for (Py_ssize_t k = count; k < most; k++) found[k] = -1;
    return count;
}

PyObject *closest_of_all(PyObject *module, PyObject *args) {
    PyObject *distance, *found;
    Arrays arrays = {.held = 0};
    double reach, *near;
    if (!PyArg_ParseTuple(args, "OdO:closest", &distance, &reach, &found)) return NULL;
    const Py_buffer *from = hold(&arrays, distance, "distance", "d", D, PyBUF_ND);
    const Py_buffer *to = from == NULL ? NULL : hold(&arrays, found, "found", "lq", D, PyBUF_ND | WRITTEN);
    if (to == NULL) return done(&arrays, NULL);
    if (from->ndim != 2 || to->ndim != 2 || from->shape[0] != to->shape[0]) {
        PyErr_SetString(PyExc_ValueError, "closest: not (M, N) and (M, K)");
        return done(&arrays, NULL);
    }
    const Py_ssize_t rows = from->shape[0], n = from->shape[1], most = to->shape[1];
    if ((near = room_for(&arrays, 2 * most)) == NULL) return done(&arrays, NULL);
    int64_t *row = (int64_t *)(near + most); /* of one row, because arrays may be unaligned */
    Py_ssize_t largest = 0;
    for (Py_ssize_t m = 0; m < rows; m++) {
        const Py_ssize_t count = nearest_first((const char *)from->buf + m * n * D, n, reach, most, near, row);
        memcpy((char *)to->buf + m * most * D, row, most * D);
        if (count > largest) largest = count;
    }
    return done(&arrays, PyLong_FromSsize_t(largest));
}

typedef struct { /* arguments as in ranking.py; arrays begin anywhere */
    const char *own, *others, *uavs;
    char *away, *closing, *squared, *found;
    Py_ssize_t rows, n, most;
    double reach;
    double *distance, *near; /* room for n and 2 * most */
} Neighbours;

FOR_AXES Py_ssize_t neighbours(const int axes, const Neighbours *a) {
    const Py_ssize_t n = a->n;
    int64_t *row = (int64_t *)(a->near + a->most);
    Py_ssize_t largest = 0;
    for (Py_ssize_t m = 0; m < a->rows; m++) {
        const char *others = a->others + m * 2 * axes * n * D;
        double here[2 * MOST_AXES], apart[2 * MOST_AXES];
        const int64_t uav = index_at(a->uavs, m);
        memcpy(here, a->own + m * 2 * axes * D, 2 * axes * D);
        for (Py_ssize_t j = 0; j < n; j++) {
            for (int k = 0; k < axes; k++) apart[k] = here[k] - double_at(others, k * n + j);
            a->distance[j] = inner(axes, apart, apart);
        }
        a->distance[uav] = NAN;
        const Py_ssize_t count = nearest_first((const char *)a->distance, n, a->reach, a->most, a->near, row);
        if (count > largest) largest = count;
        for (Py_ssize_t place = 0; place < a->most; place++) {
            const Py_ssize_t j = row[place] < 0 ? n - 1 : row[place], to = m * a->most + place;
            for (int k = 0; k < 2 * axes; k++) apart[k] = here[k] - double_at(others, k * n + j);
            double squared = inner(axes, apart, apart);
            if (row[place] >= 0 && squared < NEVER_NEARER_M * NEVER_NEARER_M) {
                for (int k = 1; k < axes; k++) apart[k] = 0.0;
                apart[0] = uav < j ? -NEVER_NEARER_M : NEVER_NEARER_M;
                squared = NEVER_NEARER_M * NEVER_NEARER_M;
            }
            memcpy(a->away + to * axes * D, apart, axes * D);
            memcpy(a->closing + to * axes * D, apart + axes, axes * D);
            memcpy(a->squared + to * D, &squared, D);
        }
        memcpy(a->found + m * a->most * D, row, a->most * D);
    }
    return largest;
}

PyObject *neighbours_of_all(PyObject *module, PyObject *args) {
    PyObject *own, *others, *uavs, *away, *closing, *squared, *found;
    Arrays arrays = {.held = 0};
    Neighbours a;
    int axes;
    if (!PyArg_ParseTuple(args, "OOOdOOOO:neighbours", &own, &others, &uavs, &a.reach, &away, &closing, &squared, &found))
        return NULL;
    if ((a.rows = rows_of(&arrays, own, "own", 2, &axes)) < 0) return done(&arrays, NULL);
    const Py_buffer *states = hold(&arrays, others, "others", "d", D, PyBUF_ND);
    if (states == NULL) return done(&arrays, NULL);
    if (states->ndim != 3 || states->shape[0] != a.rows || states->shape[1] != 2 * axes) {
        PyErr_SetString(PyExc_ValueError, "others: not the states of all UAVs for each row");
        return done(&arrays, NULL);
    }
    a.n = states->shape[2];
    if (!sized(hold(&arrays, uavs, "uavs", "lq", D, READ), "uavs", a.rows * D)) return done(&arrays, NULL);
    for (Py_ssize_t m = 0; m < a.rows; m++) {
        if ((uint64_t)index_at(arrays.view[2].buf, m) < (uint64_t)a.n) continue;
        PyErr_SetString(PyExc_ValueError, "uavs: a number that no UAV has");
        return done(&arrays, NULL);
    }
    const Py_buffer *to = hold(&arrays, found, "found", "lq", D, PyBUF_ND | WRITTEN);
    if (to == NULL) return done(&arrays, NULL);
    if (to->ndim != 2 || to->shape[0] != a.rows) {
        PyErr_SetString(PyExc_ValueError, "found: not (M, K)");
        return done(&arrays, NULL);
    }
    a.most = to->shape[1];
    const Py_ssize_t places = a.rows * a.most;
    if (!doubles(&arrays, away, "away", places * axes, WRITTEN)
        || !doubles(&arrays, closing, "closing", places * axes, WRITTEN)
        || !doubles(&arrays, squared, "squared", places, WRITTEN)
        || (a.distance = room_for(&arrays, a.n + 2 * a.most)) == NULL)
        return done(&arrays, NULL);
    a.near = a.distance + a.n;
    a.own = arrays.view[0].buf, a.others = arrays.view[1].buf, a.uavs = arrays.view[2].buf;
    a.found = arrays.view[3].buf, a.away = arrays.view[4].buf, a.closing = arrays.view[5].buf;
    a.squared = arrays.view[6].buf;
    return done(&arrays, PyLong_FromSsize_t(BY_AXES(axes, neighbours, &a)));
}
