/* The radio of a tick, compiled: the module channel/kernel.py imports. The mathematics is in link.c.
 *
 * The Python form is the definition and the fallback. This one gives the same bits.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <string.h>

#include "link.h"

enum { MOST_ARRAYS = 5, ANY = -1 };

/* An array as a function takes it: what it holds, as a buffer's format names it, and whether it is written. */
typedef struct {
    const char *name, *format;
    int bytes, written;
} Kind;

static const Kind NORMAL = {"normal", "d", 8, 0}, THRESHOLD = {"threshold", "d", 8, 0}, STATES = {"states", "d", 8, 0};
static const Kind SLOTS_OUT = {"slots", "lq", 8, 1}, MISSING_OUT = {"missing", "lq", 8, 1};
static const Kind SLOTS = {"slots", "lq", 8, 0}, MISSING = {"missing", "lq", 8, 0}, FIRST = {"first", "lq", 8, 0};
static const Kind TEMPLATE = {"template", "i", 4, 0}, RECORD = {"record", "i", 4, 1};

/* The arrays of a call, as far as they are held. */
typedef struct {
    Py_buffer view[MOST_ARRAYS];
    int held;
} Arrays;

static void let_go(Arrays *arrays) {
    while (arrays->held) PyBuffer_Release(&arrays->view[--arrays->held]);
}

/* Holds one more array of `count` numbers, if that is not ANY; their number, or -1 and an exception. */
static Py_ssize_t hold(Arrays *arrays, PyObject *array, const Kind *kind, Py_ssize_t count) {
    Py_buffer *view = &arrays->view[arrays->held];
    if (PyObject_GetBuffer(array, view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (kind->written ? PyBUF_WRITABLE : 0)) < 0)
        return -1;
    arrays->held++;
    const char *format = view->format == NULL ? "B" : view->format;
    if (format[0] == '\0' || format[1] != '\0' || strchr(kind->format, format[0]) == NULL
        || view->itemsize != kind->bytes) {
        PyErr_Format(PyExc_ValueError, "%s: format %s, expected %s", kind->name, format, kind->format);
        return -1;
    }
    const Py_ssize_t numbers = view->len / kind->bytes; /* never count * bytes, which can be more than there are */
    if (count == ANY || numbers == count) return numbers;
    PyErr_Format(PyExc_ValueError, "%s: %zd numbers, expected %zd", kind->name, numbers, count);
    return -1;
}

static PyObject *py_carry(PyObject *module, PyObject *args) {
    PyObject *normal, *threshold, *slots, *missing, *result = NULL;
    Arrays arrays = {.held = 0};
    Ahead ahead;
    Message message;
    long long needed, most;
    ptrdiff_t *room = NULL, busy;
    int begun;
    if (!PyArg_ParseTuple(args, "OddOLLpOO:carry", &normal, &ahead.xi, &ahead.chi, &threshold, &needed, &most, &begun,
                          &slots, &missing))
        return NULL;
    const Py_ssize_t numbers = hold(&arrays, normal, &NORMAL, ANY);
    const Py_ssize_t links = numbers < 0 ? -1 : hold(&arrays, slots, &SLOTS_OUT, ANY);
    if (links < 0 || hold(&arrays, missing, &MISSING_OUT, links) < 0) goto done;
    const Py_ssize_t thresholds = hold(&arrays, threshold, &THRESHOLD, ANY);
    if (thresholds < 0) goto done;
    if (numbers % PATHS || (thresholds != 1 && thresholds != links)) {
        PyErr_Format(PyExc_ValueError, "threshold: %zd, normal: %zd for %zd links", thresholds, numbers, links);
        goto done;
    }
    room = PyMem_Malloc(links * sizeof *room);
    if (room == NULL) {
        PyErr_NoMemory();
        goto done;
    }
    ahead.normal = arrays.view[0].buf, ahead.slots = numbers / PATHS;
    message = (Message){arrays.view[3].buf, thresholds == 1, needed, most};
    const ptrdiff_t used =
        carry(&ahead, &message, begun, links, arrays.view[1].buf, arrays.view[2].buf, room, &busy);
    result = Py_BuildValue("nn", (Py_ssize_t)used, (Py_ssize_t)busy);
done:
    PyMem_Free(room);
    let_go(&arrays);
    return result;
}

/* Whether transmissions begin one after the other, the first with the first link. */
static int sound(const int64_t *first, Py_ssize_t transmissions, Py_ssize_t links) {
    int ascending = transmissions ? first[0] == 0 : links == 0;
    for (Py_ssize_t k = 0; ascending && k < transmissions; k++)
        ascending = first[k] < (k + 1 < transmissions ? first[k + 1] : links);
    if (!ascending) PyErr_SetString(PyExc_ValueError, "first: not of one transmission after the other");
    return ascending;
}

/* How many numbers the records of so many links have, or -1 and an exception where that is beyond counting. */
static Py_ssize_t of_records(Py_ssize_t links) {
    if (links <= PY_SSIZE_T_MAX / COLUMNS) return links * COLUMNS;
    PyErr_Format(PyExc_ValueError, "slots: %zd links are too many", links);
    return -1;
}

/* Whether a record can hold these slots, and 64 bits their sum: not negative, in 32 bits each. */
static int countable(const int64_t *slots, Py_ssize_t links) {
    int fits = links <= INT64_MAX / INT32_MAX;
    for (Py_ssize_t i = 0; fits && i < links; i++) fits = slots[i] >= 0 && slots[i] <= INT32_MAX;
    if (!fits) PyErr_SetString(PyExc_ValueError, "slots: more than a record can hold, or fewer than none");
    return fits;
}

static PyObject *py_account(PyObject *module, PyObject *args) {
    PyObject *template, *slots, *missing, *first, *record, *result = NULL;
    Arrays arrays = {.held = 0};
    int tick;
    if (!PyArg_ParseTuple(args, "OiOOOO:account", &template, &tick, &slots, &missing, &first, &record)) return NULL;
    const Py_ssize_t links = hold(&arrays, slots, &SLOTS, ANY);
    if (links < 0 || hold(&arrays, missing, &MISSING, links) < 0) goto done;
    const Py_ssize_t columns = of_records(links);
    if (columns < 0 || hold(&arrays, template, &TEMPLATE, columns) < 0 || hold(&arrays, record, &RECORD, columns) < 0)
        goto done;
    const Py_ssize_t transmissions = hold(&arrays, first, &FIRST, ANY);
    const Py_buffer *view = arrays.view;
    if (transmissions < 0 || !sound(view[4].buf, transmissions, links) || !countable(view[0].buf, links)) goto done;
    const Account sum =
        account(view[2].buf, tick, links, view[0].buf, view[1].buf, transmissions, view[4].buf, view[3].buf);
    result = Py_BuildValue("LLL", (long long)sum.outages, (long long)sum.slots, (long long)sum.longest);
done:
    let_go(&arrays);
    return result;
}

static PyObject *py_within(PyObject *module, PyObject *args) {
    PyObject *states, *result = NULL;
    Arrays arrays = {.held = 0};
    double diagonal_squared;
    if (!PyArg_ParseTuple(args, "Od:within", &states, &diagonal_squared)) return NULL;
    const Py_ssize_t numbers = hold(&arrays, states, &STATES, ANY);
    if (numbers >= 0 && numbers % SIZE) PyErr_Format(PyExc_ValueError, "states: %zd numbers are none", numbers);
    else if (numbers >= 0) result = PyBool_FromLong(within(arrays.view[0].buf, numbers / SIZE, diagonal_squared));
    let_go(&arrays);
    return result;
}

static PyMethodDef methods[] = {
    {"carry", py_carry, METH_VARARGS,
     "carry(normal, xi, chi, threshold, needed, most, begun, slots, missing)\n\n"
     "Carries a message over links, as far as the normal numbers go, two a slot; the last two are written, and read only\n"
     "where it has begun. Returns of how many slots they were used, and how many it takes to go on; 0: it is over."},
    {"account", py_account, METH_VARARGS,
     "account(template, tick, slots, missing, first, record)\n\n"
     "Writes the record of a batch. Returns outages, slots spent, and the most of each transmission, summed."},
    {"within", py_within, METH_VARARGS,
     "within(states, diagonal_squared)\n\n"
     "Whether a box around all UAVs has no longer diagonal."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernel", "The radio of a tick, compiled.", 0, methods};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModule_Create(&definition); }
