/* A plain tick from the bytes of a Sense to those of an Act (agent/reflex.py), in one call without a Python object but
 * these: all else it works on is found, checked and held once.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <math.h>
#include <string.h>

#include "turn.h"

typedef struct { const char *text; Py_ssize_t size; } Text;

/* The messages of a kind: what comes before the tick, between it and the arrays, and after each of them. */
typedef struct { Text before, between, after, end; } Kind;

typedef struct { Kind sense, act; } Pair;

enum { VALUE, DENSITY, VALUE_OUT, DENSITY_OUT, ARRAYS };

typedef struct {
    PyObject_HEAD
    PyObject *capsule, *kinds; /* what the pointers below point into */
    const Tables *tables;
    Pair *pairs;
    Py_ssize_t count, rows;
    double bound;
    Py_buffer view[ARRAYS];
    int views; /* of them, held */
} Turn;

static void turn_dealloc(PyObject *self) {
    Turn *turn = (Turn *)self;
    PyTypeObject *type = Py_TYPE(self);
    while (turn->views) PyBuffer_Release(&turn->view[--turn->views]);
    PyMem_Free(turn->pairs);
    Py_XDECREF(turn->kinds);
    Py_XDECREF(turn->capsule);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

static int kind(PyObject *pieces, Kind *k) {
    return PyArg_ParseTuple(pieces, "y#y#y#|y#:kind", &k->before.text, &k->before.size, &k->between.text, &k->between.size,
                            &k->after.text, &k->after.size, &k->end.text, &k->end.size);
}

static int take_kinds(Turn *turn, PyObject *kinds) {
    Py_INCREF(turn->kinds = kinds);
    turn->pairs = PyMem_Calloc(PyTuple_Size(kinds), sizeof *turn->pairs);
    if (turn->pairs == NULL) return PyErr_NoMemory(), -1;
    for (; turn->count < PyTuple_Size(kinds); turn->count++) {
        PyObject *sense, *act;
        Pair *pair = &turn->pairs[turn->count];
        if (!PyArg_ParseTuple(PyTuple_GetItem(kinds, turn->count), "O!O!:kinds", &PyTuple_Type, &sense, &PyTuple_Type, &act)
            || !kind(sense, &pair->sense) || !kind(act, &pair->act))
            return -1;
    }
    return 0;
}

static int take_arrays(Turn *turn, PyObject **array) {
    const Py_ssize_t d = sizeof(double), floats[ARRAYS] = {2 * VALUES, 2 * DENSITIES, 2 * VALUES, 2 * DENSITIES};
    for (int k = 0; k < ARRAYS; k++) {
        Py_buffer *view = &turn->view[k];
        if (PyObject_GetBuffer(array[k], view, PyBUF_C_CONTIGUOUS | (k >= VALUE_OUT ? PyBUF_WRITABLE : 0)) < 0) return -1;
        turn->views++;
        if (k == VALUE) turn->rows = view->len / (floats[VALUE] * d);
        if (!turn->rows || view->len != turn->rows * floats[k] * d || view->itemsize != d) {
            PyErr_Format(PyExc_ValueError, "array %d has %zd bytes, expected %zd", k, view->len, turn->rows * floats[k] * d);
            return -1;
        }
    }
    return 0;
}

static PyObject *turn_new(PyTypeObject *type, PyObject *args, PyObject *named) {
    PyObject *capsule, *kinds, *array[ARRAYS];
    double bound;
    if (named != NULL && PyDict_Size(named)) return PyErr_Format(PyExc_TypeError, "Turn takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "OdO!OOOO:Turn", &capsule, &bound, &PyTuple_Type, &kinds, &array[VALUE], &array[DENSITY],
                          &array[VALUE_OUT], &array[DENSITY_OUT]))
        return NULL;
    const Tables *tables = tables_in(capsule);
    if (tables == NULL) return NULL;
    Turn *turn = (Turn *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0); /* all zeros */
    if (turn == NULL) return NULL;
    Py_INCREF(turn->capsule = capsule);
    turn->tables = tables;
    turn->bound = bound;
    if (take_kinds(turn, kinds) < 0 || take_arrays(turn, array) < 0) Py_CLEAR(turn);
    return (PyObject *)turn;
}

static char *put(char *end, const void *what, Py_ssize_t size) {
    memcpy(end, what, size);
    return end + size;
}

/* Bytes may begin anywhere. */
static double double_at(const char *text, Py_ssize_t k) {
    double number;
    memcpy(&number, text + k * (Py_ssize_t)sizeof number, sizeof number);
    return number;
}

/* A whole number as MessagePack has it, in as few bytes as it takes; returns how many, at most 9. */
static Py_ssize_t whole(unsigned long long number, char *to) {
    int size = number < 128 ? 0 : number < 256 ? 1 : number < 65536 ? 2 : number >> 32 == 0 ? 4 : 8;
    if (size == 0) to[0] = (char)number;
    else to[0] = (char)(size == 1 ? 0xcc : size == 2 ? 0xcd : size == 4 ? 0xce : 0xcf);
    for (int k = 0; k < size; k++) to[1 + k] = (char)(number >> 8 * (size - 1 - k));
    return 1 + size;
}

/* Where the array begins in `raw`, if it is a message of that kind and tick with nothing but one; or NULL. */
static const char *begins(const Kind *k, Text raw, Text tick) {
    const char *at = raw.text;
    if (raw.size < k->before.size + tick.size + k->between.size + k->after.size) return NULL;
    if (memcmp(at, k->before.text, k->before.size) || memcmp(at += k->before.size, tick.text, tick.size)
        || memcmp(at += tick.size, k->between.text, k->between.size)
        || memcmp(raw.text + raw.size - k->after.size, k->after.text, k->after.size))
        return NULL;
    return at + k->between.size;
}

/* The bytes of the Act of that kind, or NULL: without an error where a number that came out is not below the bound. */
static PyObject *act_on(Turn *turn, const char *states, const Kind *say, Text tick) {
    const Py_ssize_t d = sizeof(double), rows = turn->rows, v = 2 * VALUES * d, f = 2 * DENSITIES * d, out = NUMBERS * d;
    const char *value_out = turn->view[VALUE_OUT].buf, *density_out = turn->view[DENSITY_OUT].buf;
    Py_ssize_t size = say->before.size + tick.size + say->between.size + rows * out + say->after.size;
    if (say->end.text != NULL) size += rows * (v + f) + say->end.size;
    PyObject *act = PyBytes_FromStringAndSize(NULL, size);
    if (act == NULL) return NULL;
    char *end = put(PyBytes_AsString(act), say->before.text, say->before.size);
    end = put(put(end, tick.text, tick.size), say->between.text, say->between.size);
    const Rows all = {states, turn->view[VALUE].buf, turn->view[DENSITY].buf,
                      turn->view[VALUE_OUT].buf, turn->view[DENSITY_OUT].buf, end};
    step_rows(turn->tables, &all, rows);
    for (Py_ssize_t k = 0; k < rows * NUMBERS; k++)
        if (!(fabs(double_at(end, k)) < turn->bound)) { /* NaN is below nothing */
            Py_DECREF(act);
            return NULL;
        }
    end = put(end + rows * out, say->after.text, say->after.size);
    if (say->end.text == NULL) return act;
    for (Py_ssize_t m = 0; m < rows; m++) /* agent.minds.Minds.models */
        end = put(put(end, value_out + m * v, v), density_out + m * f, f);
    put(end, say->end.text, say->end.size);
    return act;
}

static PyObject *turn_answer(PyObject *self, PyObject *const *args, Py_ssize_t count) {
    Turn *turn = (Turn *)self;
    Text raw;
    char digits[9];
    if (count != 2) return PyErr_Format(PyExc_TypeError, "answer takes 2 arguments, %zd given", count);
    if (PyBytes_AsStringAndSize(args[0], (char **)&raw.text, &raw.size) < 0) return NULL;
    unsigned long long number = PyLong_AsUnsignedLongLong(args[1]);
    if (number == (unsigned long long)-1 && PyErr_Occurred()) return NULL;
    const Text tick = {digits, whole(number, digits)};
    const char *states = NULL;
    const Pair *pair = turn->pairs;
    for (Py_ssize_t k = 0; k < turn->count && states == NULL; k++)
        if ((states = begins(&turn->pairs[k].sense, raw, tick)) != NULL) pair = &turn->pairs[k];
    if (states == NULL || !turn->tables->learns_density) Py_RETURN_NONE;
    const Py_ssize_t floats = turn->rows * SIZE, brought = raw.text + raw.size - pair->sense.after.size - states;
    if (brought != floats * (Py_ssize_t)sizeof(double)) Py_RETURN_NONE;
    for (Py_ssize_t k = 0; k < floats; k++)
        if (!isfinite(double_at(states, k))) Py_RETURN_NONE;
    PyObject *act = act_on(turn, states, &pair->act, tick);
    if (act == NULL && !PyErr_Occurred()) Py_RETURN_NONE;
    return act;
}

static PyMethodDef turn_methods[] = {
    {"answer", (PyCFunction)(void (*)(void))turn_answer, METH_FASTCALL,
     "answer(raw, tick)\n\n"
     "The bytes of the Act to a plain Sense of that tick, what is learned being in value_out and density_out, which are\n"
     "overwritten, and reported where an Act of its kind has an end. None, and those two are of no use: it is no Sense\n"
     "of one of the kinds, not finite, of other rows, or a number that came out is not below the bound."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot turn_slots[] = {
    {Py_tp_doc, "Turn(tables, bound, ((sense, act), ...), value, density, value_out, density_out)\n\n"
                "sense: (before, between, after), act: (before, between, after[, end]): around the tick and the arrays."},
    {Py_tp_new, turn_new},
    {Py_tp_dealloc, turn_dealloc},
    {Py_tp_methods, turn_methods},
    {0, NULL},
};

PyType_Spec turn_spec = {"agent._kernel.Turn", sizeof(Turn), 0, Py_TPFLAGS_DEFAULT, turn_slots};
