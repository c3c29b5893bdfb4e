/* What the world does in every tick, compiled: the module worldsim/kernel.py imports. The mathematics of a tick is in
 * tick.c; what nodes said is in said.c, what is measured of all in measured.c.
 *
 * The Python forms, worldsim/physics.py, commands.py and metrics.py among them, are the definition and the fallback. These
 * give the same bits.
 */
#include "kernel.h"

#include <string.h>

#include "tick.h"

enum {
    STATES, STATUS, ACCELERATIONS, GUST, NOISE, /* read */
    MOVED, ENERGY, DISTANCE, SPEED_SUM, TICKS_ON_WAY, NUMBERS_OUT, MARKS, ARRAYS /* written */
};

/* What an array holds: a kind of number, as a buffer's format names it, and how many a UAV. */
static const struct { const char *name, *format; int bytes, each; } SHAPE[ARRAYS] = {
    {"states", "d", 8, SIZE}, {"status", "B", 1, 1}, {"accelerations", "d", 8, AXES}, {"gust", "d", 8, AXES},
    {"noise", "d", 8, AXES}, {"moved", "d", 8, SIZE}, {"energy", "d", 8, 1}, {"distance", "d", 8, 1},
    {"speed_sum", "d", 8, 1}, {"ticks_on_way", "lq", 8, 1}, {"numbers", "d", 8, 0}, {"marks", "B", 1, 1},
};

/* Whether a view holds what it should of so many UAVs in so many swarms. */
static int fits(const Py_buffer *view, int k, Py_ssize_t uavs, Py_ssize_t swarms) {
    const char *format = view->format == NULL ? "B" : view->format;
    Py_ssize_t count = k == NUMBERS_OUT ? swarms * NUMBERS : uavs * SHAPE[k].each;
    if (format[0] == '\0' || format[1] != '\0' || strchr(SHAPE[k].format, format[0]) == NULL) {
        PyErr_Format(PyExc_ValueError, "%s: format %s, expected %s", SHAPE[k].name, format, SHAPE[k].format);
        return 0;
    }
    if (view->itemsize == SHAPE[k].bytes && view->len == count * SHAPE[k].bytes) return 1;
    PyErr_Format(PyExc_ValueError, "%s: %zd bytes, expected %zd", SHAPE[k].name, view->len, count * SHAPE[k].bytes);
    return 0;
}

static PyObject *advance(PyObject *module, PyObject *args) {
    PyObject *array[ARRAYS], *result = NULL;
    Py_buffer view[ARRAYS];
    const char *constants;
    Py_ssize_t length, n;
    int measures, held = 0, any = 0;
    double *room = NULL;
    if (!PyArg_ParseTuple(args, "y#npOOOOOOOOOOOO:advance", &constants, &length, &n, &measures, &array[STATES],
                          &array[STATUS], &array[ACCELERATIONS], &array[GUST], &array[NOISE], &array[MOVED],
                          &array[ENERGY], &array[DISTANCE], &array[SPEED_SUM], &array[TICKS_ON_WAY],
                          &array[NUMBERS_OUT], &array[MARKS]))
        return NULL;
    Constants c;
    if (length != sizeof c) return PyErr_Format(PyExc_ValueError, "constants: %zd bytes, expected %zu", length, sizeof c);
    memcpy(&c, constants, sizeof c);
    for (; held < ARRAYS; held++) {
        int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (held >= MOVED ? PyBUF_WRITABLE : 0);
        if (array[held] == Py_None && held == GUST) memset(&view[held], 0, sizeof view[held]);
        else if (PyObject_GetBuffer(array[held], &view[held], flags) < 0) goto done;
    }
    const Py_ssize_t uavs = view[STATES].len / (SIZE * (Py_ssize_t)sizeof(double));
    if (n < 1 || uavs % n) {
        PyErr_Format(PyExc_ValueError, "%zd UAVs are no swarms of %zd", uavs, n);
        goto done;
    }
    for (int k = 0; k < ARRAYS; k++)
        if (view[k].obj != NULL && !fits(&view[k], k, uavs, uavs / n)) goto done;
    if (uavs == 0) goto told;
    /* n is a number of UAVs that are there, so what is per UAV does not overflow; what is per pair might */
    if (measures && n > PY_SSIZE_T_MAX / (Py_ssize_t)sizeof(double) / n - COLUMNS) {
        PyErr_NoMemory();
        goto done;
    }
    room = PyMem_Malloc((n * COLUMNS + (measures ? n * n : 0)) * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    for (Py_ssize_t swarm = 0, i = 0; i < uavs; swarm++, i += n) {
        double *gust = view[GUST].buf;
        const Swarm s = {
            .states = (double *)view[STATES].buf + i * SIZE,
            .accelerations = (double *)view[ACCELERATIONS].buf + i * AXES,
            .gust = gust == NULL ? NULL : gust + i * AXES,
            .noise = (double *)view[NOISE].buf + i * AXES,
            .status = (uint8_t *)view[STATUS].buf + i,
            .moved = (double *)view[MOVED].buf + i * SIZE,
            .energy = (double *)view[ENERGY].buf + i,
            .distance = (double *)view[DISTANCE].buf + i,
            .speed_sum = (double *)view[SPEED_SUM].buf + i,
            .numbers = (double *)view[NUMBERS_OUT].buf + swarm * NUMBERS,
            .ticks_on_way = (int64_t *)view[TICKS_ON_WAY].buf + i,
            .marks = (uint8_t *)view[MARKS].buf + i,
        };
        any |= tick(&c, &s, n, room, measures ? room + n * COLUMNS : NULL);
    }
told:
    result = PyLong_FromLong(any);
done:
    PyMem_Free(room);
    while (held--)
        if (view[held].obj != NULL) PyBuffer_Release(&view[held]);
    return result;
}

int holds(const Py_buffer *view, Py_ssize_t count) {
    const char *format = view->format == NULL ? "B" : view->format;
    if (strcmp(format, "d") == 0 && view->len == count * (Py_ssize_t)sizeof(double)) return 1;
    PyErr_Format(PyExc_ValueError, "%zd bytes of format %s, expected %zd doubles", view->len, format, count);
    return 0;
}

static PyMethodDef methods[] = {
    {"distances", distances_of, METH_O,
     "distances(columns)\n\nThe sum of the distances of all pairs of points, given as all x and then all y."},
    {"near", near_of, METH_VARARGS,
     "near(columns, reach, most, least)\n\n"
     "Of points given as all x, ascending, and then all y: how many pairs are at most so far apart, and as the bytes of\n"
     "indices (K, 2), i < j, those that are less; both squared. None of them is farther apart along x than the reach."},
    {"spread", spread_of, METH_VARARGS,
     "spread(models, n, width, bound)\n\n"
     "Root-mean-square distance of n models of so many weights from their mean. None where there is no model, or a\n"
     "weight is not below the bound."},
    {"enter", enter, METH_VARARGS,
     "enter(said, bound, accelerations, diagnostics)\n\n"
     "The rows of a list of bytes, each the outcome of a UAV, into two arrays; returns the largest of the first two\n"
     "diagnostics. None, and nothing is written, where a number is not below the bound."},
    {"advance", advance, METH_VARARGS,
     "advance(constants, n, measures, states, status, accelerations, gust | None, noise, moved, energy, distance,\n"
     "speed_sum, ticks_on_way, numbers, marks)\n\n"
     "One tick of swarms of n UAVs, one after the other; all but the first eight are written. Returns which marks there\n"
     "are. numbers, a swarm: highest speed of who is on the way; where pairs are measured, the mean difference of speeds\n"
     "and the number of pairs that are near."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernel", "The world's tick, compiled.", 0, methods};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModule_Create(&definition); }
