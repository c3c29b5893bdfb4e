/* The extension kernels._native: functions of arrays, checked here. The mathematics is in rows.h, pairs.c and halfplanes.c.
 *
 * kernels/reference.py is the definition; this gives the same bits: every sum is taken in NumPy's order and nothing is
 * contracted into fused operations.
 */
#include "wire.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "learn.h"
#include "native.h"

enum { D = sizeof(double), MOST_ARRAYS = 5, READ = 0, WRITTEN = PyBUF_WRITABLE };

/* The arrays of a call, as far as they are held, and the room it works in. */
typedef struct {
    Py_buffer view[MOST_ARRAYS];
    int held;
    double *room;
} Arrays;

/* Lets go of them all; returns `result`. */
static PyObject *done(Arrays *arrays, PyObject *result) {
    while (arrays->held) PyBuffer_Release(&arrays->view[--arrays->held]);
    PyMem_Free(arrays->room);
    return result;
}

/* Holds one more array, contiguous unless `flags` ask for strides; NULL and an exception where it does not hold numbers
 * of that format and size. */
static Py_buffer *hold(Arrays *arrays, PyObject *array, const char *name, const char *format, int size, int flags) {
    Py_buffer *view = &arrays->view[arrays->held];
    const int memory = flags == PyBUF_STRIDES ? 0 : PyBUF_C_CONTIGUOUS;
    if (PyObject_GetBuffer(array, view, memory | PyBUF_FORMAT | flags) < 0) return NULL;
    arrays->held++;
    const char *has = view->format == NULL ? "B" : view->format;
    has += has[0] == '=' || has[0] == '@'; /* as NumPy marks arrays that begin anywhere */
    if (has[0] != '\0' && has[1] == '\0' && strchr(format, has[0]) != NULL && view->itemsize == size) return view;
    PyErr_Format(PyExc_ValueError, "%s: format %s, expected %s", name, has, format);
    return NULL;
}

static int fits(const Py_buffer *view, const char *name, Py_ssize_t bytes) {
    if (view == NULL) return 0;
    if (view->len != bytes) PyErr_Format(PyExc_ValueError, "%s: %zd bytes, expected %zd", name, view->len, bytes);
    return view->len == bytes;
}

/* Holds an array of so many doubles; 0 and an exception where it is none. */
static int doubles(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t count, int flags) {
    return fits(hold(arrays, array, name, "d", D, flags), name, count * D);
}

/* Holds an array of so many rows, to be read, each of as many items of `width` doubles: how many; -1 and an exception
 * where it is none. */
static Py_ssize_t items(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t rows, int width) {
    const Py_buffer *view = hold(arrays, array, name, "d", D, READ);
    const Py_ssize_t each = view == NULL || !rows ? 0 : view->len / (rows * width * D);
    return fits(view, name, rows * each * width * D) ? each : -1;
}

/* Room for so many doubles and one more; NULL and an exception without memory. */
static double *room_for(Arrays *arrays, Py_ssize_t count) {
    if ((arrays->room = PyMem_Malloc((count + 1) * D)) == NULL) PyErr_NoMemory();
    return arrays->room;
}

/* ---- learn ---- */

static const char *NAME = "meanflock.tables";
static int lanes = 1; /* how many rows this machine steps at once */

static void forget(PyObject *capsule) { PyMem_Free(PyCapsule_GetPointer(capsule, NAME)); }

static int all_below(const int32_t *index, int count, int end) {
    for (int k = 0; k < count; k++)
        if (index[k] < 0 || index[k] >= end) return 0;
    return 1;
}

/* Whether all indices point into what they are indices of. */
static int sound(const Tables *t) {
    int few = t->starts[0] == 0 && t->starts[TERMS] == PRODUCTS;
    for (int k = 0; k < TERMS; k++) /* products of a term: one at least, and no more than there are terms */
        few = few && t->starts[k] < t->starts[k + 1] && t->starts[k + 1] - t->starts[k] <= TERMS;
    return few && all_below(t->value_first, BLOCKS, FLAT) && all_below(t->value_second, BLOCKS, FLAT)
        && all_below(t->pair_first, ALL_PAIRS, FLAT) && all_below(t->pair_second, ALL_PAIRS, FLAT)
        && all_below(t->at_position, TERMS, PAIRS) && all_below(t->at_velocity, TERMS, PAIRS)
        && all_below(t->left, 2 * DENSITIES, 4 * PAIRS) && all_below(t->right, 2 * DENSITIES, 4 * PAIRS)
        && all_below(t->weight, PRODUCTS, DENSITIES) && all_below(t->term, PRODUCTS, TERMS);
}

static PyObject *tables(PyObject *module, PyObject *args) {
    PyObject *numbers, *indices, *capsule = NULL;
    Arrays arrays = {.held = 0};
    const Py_ssize_t split = offsetof(Tables, value_first), end = offsetof(Tables, starts) + sizeof((Tables *)0)->starts;
    if (!PyArg_ParseTuple(args, "OO:tables", &numbers, &indices)) return NULL;
    if (!doubles(&arrays, numbers, "numbers", split / D, READ)
        || !fits(hold(&arrays, indices, "indices", "il", 4, READ), "indices", end - split))
        return done(&arrays, NULL);
    Tables *t = PyMem_Calloc(1, sizeof *t);
    if (t == NULL) return done(&arrays, PyErr_NoMemory());
    memcpy(t, arrays.view[0].buf, split);
    memcpy((char *)t + split, arrays.view[1].buf, end - split);
    if (sound(t)) capsule = PyCapsule_New(t, NAME, forget);
    else PyErr_SetString(PyExc_ValueError, "an index of the tables points outside of them");
    if (capsule == NULL) PyMem_Free(t);
    return done(&arrays, capsule);
}

/* Three rows are stepped at once, too, with a lane to spare; two are as quick one by one. */
static void step_rows(const Tables *t, const Rows *rows, Py_ssize_t count) {
    Py_ssize_t from = 0;
#if MANY > 1
    for (Py_ssize_t left; lanes > 1 && (left = count - from) > 2; from += left < lanes ? left : lanes)
        step_many(t, rows, from, (int)(left < lanes ? left : lanes));
#endif
    for (; from < count; from++) step_one(t, rows, from, 1);
}

/* φ_G of all rows into their numbers: as it is given, (M,), or of the states they know, (M, N, 4). */
static int interaction(Arrays *arrays, PyObject *around, const Tables *t, const Rows *rows, Py_ssize_t count) {
    const Py_ssize_t each = items(arrays, around, "around", count, 1), others = each / SIZE;
    double phi_g, *products;
    if (each < 0) return 0;
    if (count && each != 1 && (each == 0 || each % SIZE)) {
        PyErr_Format(PyExc_ValueError, "around: %zd bytes for %zd rows", arrays->view[4].len, count);
        return 0;
    }
    if ((products = room_for(arrays, others)) == NULL) return 0;
    for (Py_ssize_t m = 0; m < count; m++) {
        const char *known = (const char *)arrays->view[4].buf + m * each * D;
        if (each == 1) memcpy(&phi_g, known, D);
        else phi_g = empirical(t, rows->states + m * SIZE * D, known, others, products);
        memcpy(rows->numbers + (m * NUMBERS + 4) * D, &phi_g, D);
    }
    return 1;
}

static PyObject *learn(PyObject *module, PyObject *args) {
    PyObject *capsule, *states, *weights, *around, *weights_out, *numbers;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOOOOO:learn", &capsule, &states, &weights, &around, &weights_out, &numbers)) return NULL;
    const Tables *t = PyCapsule_GetPointer(capsule, NAME);
    const Py_ssize_t count = t == NULL ? -1 : items(&arrays, states, "states", 1, SIZE);
    if (count < 0 || !doubles(&arrays, weights, "weights", count * WEIGHTS, READ)
        || !doubles(&arrays, weights_out, "weights_out", count * WEIGHTS, WRITTEN)
        || !doubles(&arrays, numbers, "numbers", count * NUMBERS, WRITTEN))
        return done(&arrays, NULL);
    const Py_buffer *of = arrays.view;
    const Rows rows = {of[0].buf, of[1].buf, of[2].buf, of[3].buf, around == Py_None};
    if (around != Py_None && !interaction(&arrays, around, t, &rows, count)) return done(&arrays, NULL);
    step_rows(t, &rows, count);
    return done(&arrays, Py_NewRef(Py_None));
}

/* ---- pairs ---- */

/* So many columns of an array of states, from `column` on, one after the other. */
static void copy_columns(const Py_buffer *states, int column, int count, double *to) {
    const Py_ssize_t n = states->len / (SIZE * D);
    const char *from = (const char *)states->buf + column * D; /* wherever it begins */
    for (Py_ssize_t i = 0; i < n; i++)
        for (int k = 0; k < count; k++) memcpy(to + k * n + i, from + (i * SIZE + k) * D, D);
}

static PyObject *align(PyObject *module, PyObject *states) {
    Arrays arrays = {.held = 0};
    double *room;
    const Py_ssize_t n = items(&arrays, states, "states", 1, SIZE);
    if (n < 0 || (room = room_for(&arrays, alignment_room(n))) == NULL) return done(&arrays, NULL);
    copy_columns(arrays.view, AXES, AXES, room);
    return done(&arrays, PyFloat_FromDouble(alignment(n, room)));
}

static PyObject *measure(PyObject *module, PyObject *args) {
    PyObject *before, *after, *found;
    Arrays arrays = {.held = 0};
    double hazard, collision, nearest, *room;
    if (!PyArg_ParseTuple(args, "OOdddO:pairs", &before, &after, &hazard, &collision, &nearest, &found)) return NULL;
    const Py_ssize_t n = items(&arrays, before, "before", 1, SIZE);
    if (n < 0 || !doubles(&arrays, after, "after", n * SIZE, READ)) return done(&arrays, NULL);
    const Py_buffer *to = hold(&arrays, found, "found", "lq", 8, WRITTEN);
    const Py_ssize_t most = to == NULL ? 0 : to->len / 16; /* of pairs of 8 bytes each */
    if (!fits(to, "found", most * 16) || (room = room_for(&arrays, pairs_room(n))) == NULL) return done(&arrays, NULL);
    copy_columns(&arrays.view[0], 0, AXES, room);
    copy_columns(&arrays.view[1], 0, AXES, room + AXES * n);
    const Measured seen = pairs(n, room, hazard, collision, nearest, to->buf, most);
    return done(&arrays, Py_BuildValue("LLd", (long long)seen.near, (long long)seen.touching, seen.nearest));
}

/* ---- nearest ---- */

static PyObject *nearest_of_all(PyObject *module, PyObject *args) {
    PyObject *wanted, *normals, *bounds, *found, *missing;
    Arrays arrays = {.held = 0};
    double limit, *room;
    if (!PyArg_ParseTuple(args, "OOOdOO:nearest", &wanted, &normals, &bounds, &limit, &found, &missing)) return NULL;
    const Py_ssize_t rows = items(&arrays, wanted, "wanted", 1, 2);
    const Py_ssize_t count = rows < 0 ? -1 : items(&arrays, normals, "normals", rows, 2);
    if (count < 0 || !doubles(&arrays, bounds, "bounds", rows * count, READ)
        || !doubles(&arrays, found, "found", rows * 2, WRITTEN) || !doubles(&arrays, missing, "missing", rows, WRITTEN)
        || (room = room_for(&arrays, 10 * count)) == NULL) /* of a row at a time, for arrays may begin anywhere */
        return done(&arrays, NULL);
    for (Py_ssize_t m = 0; m < rows; m++) {
        double point[2], a[2], *row_bounds = room + 2 * count;
        memcpy(point, (const char *)arrays.view[0].buf + m * 2 * D, 2 * D);
        memcpy(room, (const char *)arrays.view[1].buf + m * count * 2 * D, count * 2 * D);
        memcpy(row_bounds, (const char *)arrays.view[2].buf + m * count * D, count * D);
        const double need = nearest(point, room, row_bounds, count, limit, row_bounds + count, a);
        memcpy((char *)arrays.view[3].buf + m * 2 * D, a, 2 * D);
        memcpy((char *)arrays.view[4].buf + m * D, &need, D);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

/* ---- columns ---- */

static double largest(const char *numbers, Py_ssize_t count) {
    double most = 0.0, number;
    for (Py_ssize_t k = 0; k < count && most == most; k++) { /* what is not a number stays so */
        memcpy(&number, numbers + k * D, D);
        if (!(fabs(number) <= most)) most = fabs(number);
    }
    return most;
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

/* ---- repel ---- */

static PyObject *push(PyObject *module, PyObject *args) {
    PyObject *states, *known, *pushed;
    Arrays arrays = {.held = 0};
    double weight, range, *room;
    if (!PyArg_ParseTuple(args, "OOddO:repel", &states, &known, &weight, &range, &pushed)) return NULL;
    const Py_ssize_t rows = items(&arrays, states, "states", 1, SIZE);
    const Py_ssize_t others = rows < 0 ? -1 : items(&arrays, known, "known", rows, SIZE);
    if (others < 0 || !doubles(&arrays, pushed, "pushed", rows * AXES, WRITTEN)
        || (room = room_for(&arrays, 2 * others)) == NULL)
        return done(&arrays, NULL);
    for (Py_ssize_t m = 0; m < rows; m++) {
        const char *state = (const char *)arrays.view[0].buf + m * SIZE * D;
        double found[AXES];
        repel(state, (const char *)arrays.view[1].buf + m * others * SIZE * D, others, weight, range, room, found);
        memcpy((char *)arrays.view[2].buf + m * AXES * D, found, sizeof found);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

/* The docstrings are those of kernels/reference.py, halfplanes.py, separation.py and kernels/wire.py. */
static PyMethodDef methods[] = {
    {"tables", tables, METH_VARARGS, "tables(numbers, indices): both packed; checked once."},
    {"learn", learn, METH_VARARGS, "learn(tables, states, weights, around, weights_out, numbers)"},
    {"alignment", align, METH_O, "alignment(states)"},
    {"pairs", measure, METH_VARARGS, "pairs(before, after, hazard_m, collision_m, nearest_m, found)"},
    {"nearest", nearest_of_all, METH_VARARGS, "nearest(wanted, normals, bounds, limit, found, missing)"},
    {"columns", columns, METH_VARARGS, "columns(left, right, out, first)"},
    {"repel", push, METH_VARARGS, "repel(states, known, weight, range_m, pushed)"},
    {"read", wire_read, METH_VARARGS, "read(raw, kind=0, into=None)"},
    {"write", wire_write, METH_VARARGS, "write(kind, run, tick, flags, rows, columns, table, tables, frames=())"},
    {NULL, NULL, 0, NULL},
};

/* The checksum of the sources this is built from (setup.py); unsigned, 0: unknown. */
#ifndef SOURCES
#define SOURCES 0u
#endif

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_native", "Compiled kernels.", 0, methods};

PyMODINIT_FUNC PyInit__native(void) {
#if MANY > 1
    if (__builtin_cpu_supports("avx2")) lanes = MANY;
#endif
    PyObject *module = PyModule_Create(&definition), *sources = PyLong_FromUnsignedLong(SOURCES);
    if (module != NULL && (sources == NULL || PyModule_AddObjectRef(module, "SOURCES", sources) < 0)) Py_CLEAR(module);
    Py_XDECREF(sources);
    return module;
}
