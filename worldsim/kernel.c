/* What the world does in every tick, compiled: the module worldsim/kernel.py imports. The mathematics is in tick.c.
 *
 * The Python forms, worldsim/physics.py and commands.py, are the definition and the fallback. These give the same bits.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

#include "tick.h"

enum {
    STATES, STATUS, ACCELERATIONS, GUST, NOISE, /* read */
    MOVED, ENERGY, DISTANCE, SPEED_SUM, TICKS_ON_WAY, NUMBERS_OUT, MARKS, ARRAYS /* written */
};

enum { ROW = OUTCOME * sizeof(double) }; /* bytes of an outcome */

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

/* Whether a view holds so many doubles. */
static int holds(const Py_buffer *view, Py_ssize_t count) {
    const char *format = view->format == NULL ? "B" : view->format;
    if (strcmp(format, "d") == 0 && view->len == count * (Py_ssize_t)sizeof(double)) return 1;
    PyErr_Format(PyExc_ValueError, "%zd bytes of format %s, expected %zd doubles", view->len, format, count);
    return 0;
}

/* How many rows there are in a list of bytes; -1 where that is not what it is. */
static Py_ssize_t rows_of(PyObject *said) {
    Py_ssize_t rows = 0;
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        PyObject *text = PyList_GetItem(said, k);
        if (!PyBytes_Check(text) || PyBytes_Size(text) % ROW) {
            PyErr_Format(PyExc_ValueError, "item %zd is not the bytes of rows of %d doubles", k, OUTCOME);
            return -1;
        }
        rows += PyBytes_Size(text) / ROW;
    }
    return rows;
}

/* The largest of each column, or 0 where one is not below the bound. */
static int largest(PyObject *said, double bound, double *most) {
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        const char *text = PyBytes_AsString(PyList_GetItem(said, k));
        const Py_ssize_t count = PyBytes_Size(PyList_GetItem(said, k)) / (Py_ssize_t)sizeof(double);
        for (Py_ssize_t i = 0; i < count; i++) {
            double number; /* bytes may begin anywhere */
            memcpy(&number, text + i * (Py_ssize_t)sizeof number, sizeof number);
            if (!(fabs(number) < bound)) return 0; /* NaN is below nothing */
            if (fabs(number) > most[i % OUTCOME]) most[i % OUTCOME] = fabs(number);
        }
    }
    return 1;
}

static void copy(PyObject *said, double *commands, double *told) {
    for (Py_ssize_t k = 0; k < PyList_Size(said); k++) {
        const char *text = PyBytes_AsString(PyList_GetItem(said, k));
        for (Py_ssize_t left = PyBytes_Size(PyList_GetItem(said, k)); left; left -= ROW, text += ROW) {
            memcpy(commands, text, AXES * sizeof(double));
            memcpy(told, text + AXES * sizeof(double), (OUTCOME - AXES) * sizeof(double));
            commands += AXES;
            told += OUTCOME - AXES;
        }
    }
}

static PyObject *enter(PyObject *module, PyObject *args) {
    PyObject *said, *array[2], *result = NULL;
    Py_buffer view[2];
    double bound, most[OUTCOME] = {0.0};
    int held = 0;
    if (!PyArg_ParseTuple(args, "O!dOO:enter", &PyList_Type, &said, &bound, &array[0], &array[1])) return NULL;
    for (; held < 2; held++)
        if (PyObject_GetBuffer(array[held], &view[held], PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | PyBUF_WRITABLE) < 0) goto done;
    const Py_ssize_t n = rows_of(said);
    if (n < 0 || !holds(&view[0], n * AXES) || !holds(&view[1], n * (OUTCOME - AXES))) goto done;
    if (!largest(said, bound, most)) {
        Py_INCREF(result = Py_None);
        goto done;
    }
    copy(said, view[0].buf, view[1].buf);
    result = Py_BuildValue("dd", most[AXES], most[AXES + 1]);
done:
    while (held--) PyBuffer_Release(&view[held]);
    return result;
}

/* Whether so many bytes are finite floats, of the format a NumPy dtype has as its character; others are as they are. */
static int sane_floats(const char *text, Py_ssize_t size, char format) {
    int sane = 1;
    if (format == 'd')
        for (Py_ssize_t i = 0; i + 8 <= size; i += 8) {
            uint64_t bits; /* they may begin anywhere */
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7ff0000000000000) != 0x7ff0000000000000;
        }
    else if (format == 'f')
        for (Py_ssize_t i = 0; i + 4 <= size; i += 4) {
            uint32_t bits;
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7f800000) != 0x7f800000;
        }
    else if (format == 'e')
        for (Py_ssize_t i = 0; i + 2 <= size; i += 2) {
            uint16_t bits;
            memcpy(&bits, text + i, sizeof bits);
            sane &= (bits & 0x7c00) != 0x7c00;
        }
    return sane;
}

/* The text that comes next in a message, or NULL, and then with an error if it is none. */
static const char *follows(PyObject *text, const char *at, const char *end) {
    char *expected;
    Py_ssize_t length;
    if (PyBytes_AsStringAndSize(text, &expected, &length) < 0) return NULL;
    return end - at >= length && memcmp(at, expected, length) == 0 ? at + length : NULL;
}

/* The array that comes next, the same way. */
static PyObject *array_at(PyObject *said, char format, const char *at, const char *end) {
    const Py_ssize_t size = PyLong_AsSsize_t(said);
    if (size == -1 && PyErr_Occurred()) return NULL;
    if (size < 0 || end - at < size || !sane_floats(at, size, format)) return NULL;
    return PyBytes_FromStringAndSize(at, size);
}

static PyObject *split(PyObject *module, PyObject *const *args, Py_ssize_t count) {
    char *formats, *raw;
    Py_ssize_t arrays, length;
    if (count != 4 || !PyTuple_Check(args[0]) || !PyTuple_Check(args[1]))
        return PyErr_Format(PyExc_TypeError, "split takes two tuples, formats and a message");
    if (PyBytes_AsStringAndSize(args[2], &formats, &arrays) < 0 || PyBytes_AsStringAndSize(args[3], &raw, &length) < 0)
        return NULL;
    if (PyTuple_Size(args[1]) != arrays || PyTuple_Size(args[0]) != arrays + 1)
        return PyErr_Format(PyExc_ValueError, "%zd texts around %zd arrays of %zd formats", PyTuple_Size(args[0]),
                            PyTuple_Size(args[1]), arrays);
    PyObject *parts = PyTuple_New(arrays);
    const char *at = raw, *end = raw + length;
    for (Py_ssize_t k = 0; parts != NULL && k <= arrays; k++) {
        PyObject *part = NULL;
        at = follows(PyTuple_GetItem(args[0], k), at, end);
        if (k < arrays && at != NULL) part = array_at(PyTuple_GetItem(args[1], k), formats[k], at, end);
        if (part != NULL) {
            at += PyBytes_Size(part);
            PyTuple_SetItem(parts, k, part);
        } else if (k < arrays || at != end)
            Py_CLEAR(parts);
    }
    if (parts == NULL && !PyErr_Occurred()) Py_RETURN_NONE;
    return parts;
}

static PyObject *spread_of(PyObject *module, PyObject *args) {
    PyObject *models;
    Py_buffer view;
    Py_ssize_t n, width;
    double bound, apart = -1.0;
    if (!PyArg_ParseTuple(args, "Onnd:spread", &models, &n, &width, &bound)) return NULL;
    if (n < 0 || width < 1 || n > PY_SSIZE_T_MAX / 16 - width || n > PY_SSIZE_T_MAX / 16 / width)
        return PyErr_Format(PyExc_ValueError, "%zd models of %zd weights", n, width);
    if (PyObject_GetBuffer(models, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    double *room = NULL;
    if (holds(&view, n * width)) {
        room = PyMem_Malloc((2 * width + n) * sizeof *room);
        if (room == NULL) PyErr_NoMemory();
        else if (n) apart = spread(view.buf, n, width, bound, room);
    }
    PyMem_Free(room);
    PyBuffer_Release(&view);
    if (PyErr_Occurred()) return NULL;
    if (apart < 0.0) Py_RETURN_NONE;
    return PyFloat_FromDouble(apart);
}

static PyObject *distances_of(PyObject *module, PyObject *columns) {
    Py_buffer view;
    if (PyObject_GetBuffer(columns, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    const Py_ssize_t n = view.len / (AXES * (Py_ssize_t)sizeof(double));
    double *room = NULL, sum = 0.0;
    if (holds(&view, n * AXES)) {
        const double *x = view.buf;
        room = PyMem_Malloc((2 * n + 1) * sizeof *room);
        if (room == NULL) PyErr_NoMemory();
        else sum = sum_of_distances(n, x, x + n, room);
    }
    PyMem_Free(room);
    PyBuffer_Release(&view);
    return PyErr_Occurred() ? NULL : PyFloat_FromDouble(sum);
}

typedef struct { Py_ssize_t count, room, *pair; } Pairs;

static int append(void *list, ptrdiff_t i, ptrdiff_t j) {
    Pairs *pairs = list;
    if (pairs->count == pairs->room) {
        const Py_ssize_t room = 2 * pairs->room + 64;
        Py_ssize_t *pair = PyMem_Realloc(pairs->pair, room * 2 * sizeof *pair);
        if (pair == NULL) return 0;
        pairs->room = room;
        pairs->pair = pair;
    }
    pairs->pair[2 * pairs->count] = i;
    pairs->pair[2 * pairs->count++ + 1] = j;
    return 1;
}

static PyObject *near_of(PyObject *module, PyObject *args) {
    PyObject *columns, *result = NULL;
    Py_buffer view;
    Pairs touching = {0};
    double reach, most, least;
    if (!PyArg_ParseTuple(args, "Oddd:near", &columns, &reach, &most, &least)) return NULL;
    if (PyObject_GetBuffer(columns, &view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) return NULL;
    const Py_ssize_t n = view.len / (AXES * (Py_ssize_t)sizeof(double));
    if (holds(&view, n * AXES)) {
        const double *x = view.buf;
        const int64_t near = near_pairs(n, x, x + n, reach, most, least, append, &touching);
        if (near < 0) PyErr_NoMemory();
        else result = Py_BuildValue("Ly#", (long long)near, touching.pair == NULL ? "" : (char *)touching.pair,
                                    touching.count * 2 * (Py_ssize_t)sizeof *touching.pair);
    }
    PyMem_Free(touching.pair);
    PyBuffer_Release(&view);
    return result;
}

static PyMethodDef methods[] = {
    {"split", (PyCFunction)(void (*)(void))split, METH_FASTCALL,
     "split(texts, sizes, formats, raw)\n\n"
     "The bytes of the arrays between these texts, if raw is those, each of its size and its floats finite; or None."},
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
