/* The extension kernels._native: functions of arrays, checked here and in mean_field/. The mathematics is in
 * all_pairs.c, halfplanes.c, halfspaces.c and mean_field/.
 *
 * kernels/reference.py is the definition; this gives the same bits: every sum is taken in NumPy's order and nothing is
 * contracted into fused operations.
 */
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "axes.h"
#include "native.h"

/* ---- arrays ---- */

PyObject *done(Arrays *arrays, PyObject *result) {
    while (arrays->held) PyBuffer_Release(&arrays->view[--arrays->held]);
    PyMem_Free(arrays->room);
    return result;
}

Py_buffer *hold(Arrays *arrays, PyObject *array, const char *name, const char *format, int size, int flags) {
    Py_buffer *view = &arrays->view[arrays->held];
    const int memory = flags == PyBUF_STRIDES ? 0 : PyBUF_C_CONTIGUOUS;
    if (PyObject_GetBuffer(array, view, memory | PyBUF_FORMAT | flags) < 0) return NULL;
    arrays->held++;
    const char *has = view->format == NULL ? "B" : view->format;
    has += has[0] == '=' || has[0] == '@'; /* NumPy's mark of unaligned arrays */
    if (has[0] != '\0' && has[1] == '\0' && strchr(format, has[0]) != NULL && view->itemsize == size) return view;
    PyErr_Format(PyExc_ValueError, "%s: format %s, expected %s", name, has, format);
    return NULL;
}

int sized(const Py_buffer *view, const char *name, Py_ssize_t bytes) {
    if (view == NULL) return 0;
    if (view->len != bytes) PyErr_Format(PyExc_ValueError, "%s: %zd bytes, expected %zd", name, view->len, bytes);
    return view->len == bytes;
}

int doubles(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t count, int flags) {
    return sized(hold(arrays, array, name, "d", D, flags), name, count * D);
}

Py_ssize_t items(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t rows, int width) {
    const Py_buffer *view = hold(arrays, array, name, "d", D, READ);
    const Py_ssize_t each = view == NULL || !rows ? 0 : view->len / (rows * width * D);
    return sized(view, name, rows * each * width * D) ? each : -1;
}

Py_ssize_t rows_of(Arrays *arrays, PyObject *array, const char *name, int vectors, int *axes) {
    const Py_buffer *view = hold(arrays, array, name, "d", D, READ);
    if (view == NULL) return -1;
    const Py_ssize_t columns = view->ndim ? view->shape[view->ndim - 1] : 0;
    if (columns == vectors * PLANE || columns == vectors * SPACE) {
        *axes = (int)columns / vectors;
        return view->len / (columns * D);
    }
    PyErr_Format(PyExc_ValueError, "%s: %zd columns, expected %d or %d", name, columns, vectors * PLANE, vectors * SPACE);
    return -1;
}

double *room_for(Arrays *arrays, Py_ssize_t count) {
    arrays->room = count < PY_SSIZE_T_MAX / D ? PyMem_Malloc((count + 1) * D) : NULL;
    if (arrays->room == NULL) PyErr_NoMemory();
    return arrays->room;
}

/* ---- pairs ---- */

/* Copies the columns of a half of states, from `column` on, one after the other. */
static void copy_half(int axes, const Py_buffer *states, int column, double *to) {
    const Py_ssize_t width = 2 * axes, n = states->len / (width * D);
    const char *from = (const char *)states->buf + column * D; /* may be unaligned */
    for (Py_ssize_t i = 0; i < n; i++)
        for (int k = 0; k < axes; k++) memcpy(to + k * n + i, from + (i * width + k) * D, D);
}

static PyObject *align(PyObject *module, PyObject *states) {
    Arrays arrays = {.held = 0};
    double *room;
    int axes;
    const Py_ssize_t n = rows_of(&arrays, states, "states", 2, &axes);
    if (n < 0 || (room = room_for(&arrays, alignment_room(axes, n))) == NULL) return done(&arrays, NULL);
    copy_half(axes, arrays.view, axes, room);
    return done(&arrays, PyFloat_FromDouble(alignment(axes, n, room)));
}

static PyObject *measure(PyObject *module, PyObject *args) {
    PyObject *before, *after, *found;
    Arrays arrays = {.held = 0};
    double hazard, collision, nearest, *room;
    int axes;
    if (!PyArg_ParseTuple(args, "OOdddO:pairs", &before, &after, &hazard, &collision, &nearest, &found)) return NULL;
    const Py_ssize_t n = rows_of(&arrays, before, "before", 2, &axes);
    if (n < 0 || !doubles(&arrays, after, "after", n * 2 * axes, READ)) return done(&arrays, NULL);
    const Py_buffer *to = hold(&arrays, found, "found", "lq", 8, WRITTEN);
    const Py_ssize_t most = to == NULL ? 0 : to->len / 16; /* of pairs of 8 bytes each */
    if (!sized(to, "found", most * 16) || (room = room_for(&arrays, pairs_room(axes, n))) == NULL) return done(&arrays, NULL);
    copy_half(axes, &arrays.view[0], 0, room);
    copy_half(axes, &arrays.view[1], 0, room + axes * n);
    const Measured seen = pairs(axes, n, room, hazard, collision, nearest, to->buf, most);
    return done(&arrays, Py_BuildValue("LLd", (long long)seen.near, (long long)seen.touching, seen.nearest));
}

/* ---- nearest ---- */

static PyObject *nearest_of_all(PyObject *module, PyObject *args) {
    PyObject *wanted, *normals, *bounds, *found, *missing;
    Arrays arrays = {.held = 0};
    double limit, *room;
    int axes;
    if (!PyArg_ParseTuple(args, "OOOdOO:nearest", &wanted, &normals, &bounds, &limit, &found, &missing)) return NULL;
    const Py_ssize_t rows = rows_of(&arrays, wanted, "wanted", 1, &axes);
    const Py_ssize_t count = rows < 0 ? -1 : items(&arrays, normals, "normals", rows, axes);
    if (count < 0 || !doubles(&arrays, bounds, "bounds", rows * count, READ)
        || !doubles(&arrays, found, "found", rows * axes, WRITTEN)
        || !doubles(&arrays, missing, "missing", rows, WRITTEN)
        || (room = room_for(&arrays, (axes + 1 + NEAREST_ROOM) * count)) == NULL) /* of one row, because arrays may be unaligned */
        return done(&arrays, NULL);
    for (Py_ssize_t m = 0; m < rows; m++) {
        double point[MOST_AXES], a[MOST_AXES], *row_bounds = room + axes * count;
        memcpy(point, (const char *)arrays.view[0].buf + m * axes * D, axes * D);
        memcpy(room, (const char *)arrays.view[1].buf + m * count * axes * D, count * axes * D);
        memcpy(row_bounds, (const char *)arrays.view[2].buf + m * count * D, count * D);
        const double need =
            (axes == PLANE ? nearest : nearest_in_space)(point, room, row_bounds, count, limit, row_bounds + count, a);
        memcpy((char *)arrays.view[3].buf + m * axes * D, a, axes * D);
        memcpy((char *)arrays.view[4].buf + m * D, &need, D);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

/* ---- largest and columns ---- */

#define LANES 8 /* numbers that are compared at once */

static inline void compare(const char *numbers, double *most, long long *is_nan) {
    double number[LANES];
    memcpy(number, numbers, sizeof number);
    for (int lane = 0; lane < LANES; lane++) {
        most[lane] = fabs(number[lane]) > most[lane] ? fabs(number[lane]) : most[lane];
        is_nan[lane] |= number[lane] != number[lane];
    }
}

static double largest(const char *numbers, Py_ssize_t count) {
    double most[LANES] = {0.0}, rest[LANES] = {0.0};
    long long is_nan[LANES] = {0};
    for (; count >= LANES; count -= LANES, numbers += LANES * D) compare(numbers, most, is_nan);
    memcpy(rest, numbers, count * D);
    compare((char *)rest, most, is_nan);
    for (int lane = 0; lane < LANES; lane++) {
        if (is_nan[lane]) return NAN;
        if (most[lane] > most[0]) most[0] = most[lane];
    }
    return most[0];
}

static PyObject *largest_of_all(PyObject *module, PyObject *numbers) {
    Arrays arrays = {.held = 0};
    const Py_buffer *from = hold(&arrays, numbers, "numbers", "d", D, READ);
    if (from == NULL) return done(&arrays, NULL);
    return done(&arrays, PyFloat_FromDouble(largest(from->buf, from->len / D)));
}

static PyObject *columns(PyObject *module, PyObject *args) {
    PyObject *from[2], *out;
    Arrays arrays = {.held = 0};
    int first;
    if (!PyArg_ParseTuple(args, "OOOi:columns", &from[0], &from[1], &out, &first)) return NULL;
    const Py_buffer *to = hold(&arrays, out, "out", "d", D, WRITTEN);
    const int tables = from[1] == Py_None ? 1 : 2;
    if (to == NULL) return done(&arrays, NULL);
    int fit = to->ndim == 2 && first >= 0 && first <= to->shape[1] && (tables == 2 || first == to->shape[1]);
    for (int k = 0; k < tables && fit; k++) {
        const Py_buffer *part = hold(&arrays, from[k], "columns", "d", D, PyBUF_STRIDES);
        if (part == NULL) return done(&arrays, NULL);
        fit = part->ndim == 2 && part->shape[0] == to->shape[0] && part->shape[1] == (k ? to->shape[1] - first : first);
    }
    if (!fit) {
        PyErr_SetString(PyExc_ValueError, "columns: not float64 of as many rows and columns as there is room for");
        return done(&arrays, NULL);
    }
    char *at = to->buf;
    for (Py_ssize_t row = 0; row < to->shape[0]; row++)
        for (const Py_buffer *part = arrays.view + 1; part <= arrays.view + tables; part++)
            for (Py_ssize_t k = 0; k < part->shape[1]; k++, at += D)
                memcpy(at, (char *)part->buf + row * part->strides[0] + k * part->strides[1], D);
    return done(&arrays, PyFloat_FromDouble(largest(to->buf, to->shape[0] * to->shape[1])));
}

/* The docstrings are those of the NumPy forms that kernels/reference.py names. */
static PyMethodDef methods[] = {
    {"tables", learner_tables, METH_VARARGS, "tables(numbers, indices): both packed; checked once."},
    {"learn", learner_step, METH_VARARGS, "learn(tables, states, weights, around, weights_out, numbers)"},
    {"alignment", align, METH_O, "alignment(states)"},
    {"pairs", measure, METH_VARARGS, "pairs(before, after, hazard_m, collision_m, nearest_m, found)"},
    {"nearest", nearest_of_all, METH_VARARGS, "nearest(wanted, normals, bounds, limit, found, missing)"},
    {"largest", largest_of_all, METH_O, "largest(numbers)"},
    {"columns", columns, METH_VARARGS, "columns(left, right, out, first)"},
    {"move", motion_move, METH_VARARGS, "move(states, acceleration, noise, wind, drag, shake, dt, moved)"},
    {"reached", motion_reached, METH_VARARGS, "reached(states, goals, radius, within)"},
    {"fly", quadrotor_fly, METH_VARARGS, "fly(craft, states, body, wanted, outside, steps, moved, turned)"},
    {"fade", radio_fade, METH_VARARGS, "fade(normal, xi, chi, thresholds, slot, busy, missing, slots)"},
    {"send", radio_send, METH_VARARGS, "send(uniform, success, slot, busy, missing, slots)"},
    {"waves", radio_waves, METH_VARARGS, "waves(place, vectors, phase, sums)"},
    {"interpolate", radio_interpolate, METH_VARARGS, "interpolate(tables, row, place, found)"},
    {"poisson", radio_poisson, METH_VARARGS, "poisson(rates, first, terms, reached, sums)"},
    {"repel", learner_repel, METH_VARARGS, "repel(states, known, weight, range_m, pushed)"},
    {"closest", closest_of_all, METH_VARARGS, "closest(distance, reach, found)"},
    {"neighbours", neighbours_of_all, METH_VARARGS,
     "neighbours(own, others, uavs, reach, away, closing, squared, found)"},
    {"pick", links_pick, METH_VARARGS, "pick(links, chosen, picked, used)"},
    {"solve", elimination_solve, METH_VARARGS, "solve(matrices, rights, found)"},
    {"multiply", elimination_multiply, METH_VARARGS, "multiply(left, right, found)"},
    {"read", wire_read, METH_VARARGS, "read(raw, kind=0, into=None, uavs=0)"},
    {"write", wire_write, METH_VARARGS, "write(kind, run, tick, flags, rows, columns, table, tables, frames=())"},
    {NULL, NULL, 0, NULL},
};

/* The checksum of the sources this is built from (setup.py); unsigned, 0: unknown. */
#ifndef SOURCES
#define SOURCES 0u
#endif

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_native", "Compiled kernels.", 0, methods};

PyMODINIT_FUNC PyInit__native(void) {
    PyObject *module = PyModule_Create(&definition), *sources = PyLong_FromUnsignedLong(SOURCES);
    if (module != NULL && (sources == NULL || PyModule_AddObjectRef(module, "SOURCES", sources) < 0)) Py_CLEAR(module);
    Py_XDECREF(sources);
    return module;
}
