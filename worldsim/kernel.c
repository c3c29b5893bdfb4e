/* One tick of the world, compiled: the module worldsim/kernel.py imports. The mathematics is in tick.c.
 *
 * The Python form, worldsim/physics.py, is the definition and the fallback. This one gives the same bits.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
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

static PyMethodDef methods[] = {
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
