/* One tick of the learners, compiled: the module agent/kernel.py imports. The mathematics is in rows.h.
 *
 * The Python form is the definition and the fallback. This one gives the same bits: every sum is taken in NumPy's
 * order, nothing is contracted into fused operations, and the tables come from the Python classes.
 * Compiled without a compiler's leave to reorder floating point; with it, tests/agent/test_kernel.py fails.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <math.h>
#include <string.h>

#include "tables.h"

static int lanes = 1; /* how many rows this machine steps at once */

/* Three rows are stepped at once, too, with a lane to spare; two are as quick one by one. */
static void step_rows(const Tables *t, const Rows *rows, Py_ssize_t count) {
    Py_ssize_t from = 0;
#if MANY > 1
    for (Py_ssize_t left; lanes > 1 && (left = count - from) > 2; from += left < lanes ? left : lanes)
        step_many(t, rows, from, (int)(left < lanes ? left : lanes));
#endif
    for (; from < count; from++) step_one(t, rows, from, 1);
}

/* ---- Python ---- */

static const char *NAME = "meanflock.tables";

static void forget(PyObject *capsule) { PyMem_Free(PyCapsule_GetPointer(capsule, NAME)); }

static const Tables *tables_in(PyObject *capsule) { return PyCapsule_GetPointer(capsule, NAME); }

/* Copies exactly `count` items of `size` bytes out of entry `name` of a dict. */
static int copy_entry(PyObject *dict, const char *name, void *to, Py_ssize_t count, Py_ssize_t size) {
    PyObject *array = PyDict_GetItemString(dict, name);
    Py_buffer view;
    if (array == NULL) {
        PyErr_Format(PyExc_KeyError, "%s", name);
        return -1;
    }
    if (PyObject_GetBuffer(array, &view, PyBUF_C_CONTIGUOUS) < 0) return -1;
    int fits = view.len == count * size && view.itemsize == size;
    if (fits) memcpy(to, view.buf, view.len);
    else PyErr_Format(PyExc_ValueError, "%s: %zd bytes, expected %zd", name, view.len, count * size);
    PyBuffer_Release(&view);
    return fits ? 0 : -1;
}

static int all_below(const int32_t *index, int count, int end) {
    for (int k = 0; k < count; k++)
        if (index[k] < 0 || index[k] >= end) return 0;
    return 1;
}

static int sound(const Tables *t) {
    int few = t->starts[0] == 0; /* products of a term: one at least, and no more than there are terms */
    for (int k = 0; k < TERMS; k++)
        few = few && t->starts[k] < t->starts[k + 1] && t->starts[k + 1] - t->starts[k] <= TERMS;
    return few && all_below(t->value_first, BLOCKS, FLAT) && all_below(t->value_second, BLOCKS, FLAT)
        && all_below(t->pair_first, ALL_PAIRS, FLAT) && all_below(t->pair_second, ALL_PAIRS, FLAT)
        && all_below(t->at_position, TERMS, PAIRS) && all_below(t->at_velocity, TERMS, PAIRS)
        && all_below(t->left, 2 * DENSITIES, 4 * PAIRS) && all_below(t->right, 2 * DENSITIES, 4 * PAIRS)
        && all_below(t->weight, t->starts[TERMS], DENSITIES) && all_below(t->term, t->starts[TERMS], TERMS);
}

static int outside(void) {
    PyErr_SetString(PyExc_ValueError, "an index of the tables points outside of them");
    return -1;
}

static PyObject *tables(PyObject *module, PyObject *dict) {
    if (!PyDict_Check(dict)) return PyErr_Format(PyExc_TypeError, "tables come as a dict");
    Tables *t = PyMem_Calloc(1, sizeof *t);
    if (t == NULL) return PyErr_NoMemory();
    double learns = 0.0;
    int32_t products = 0;
    int failed = copy_entry(dict, "starts", t->starts, TERMS + 1, 4);
    if (!failed && t->starts[TERMS] >= 0 && t->starts[TERMS] <= PRODUCTS_MOST) products = t->starts[TERMS];
    else if (!failed) failed = outside();
#define DOUBLES(field, count) || copy_entry(dict, #field, t->field, count, 8)
#define INDICES(field, count) || copy_entry(dict, #field, t->field, count, 4)
#define NUMBER(field) || copy_entry(dict, #field, &t->field, 1, 8)
    failed = failed DOUBLES(scale, SIZE) DOUBLES(value_factor, BLOCKS) DOUBLES(pair_factor, ALL_PAIRS)
        DOUBLES(factorial, TERMS) DOUBLES(monomials, TERMS * NODES) DOUBLES(kernel, NODES) DOUBLES(wind, AXES)
        NUMBER(c1) NUMBER(c2) NUMBER(c3) NUMBER(epsilon) NUMBER(mu_h) NUMBER(push) NUMBER(kappa) NUMBER(drag)
        NUMBER(half_variance) NUMBER(gain) NUMBER(arrived_squared) NUMBER(mu_f)
        INDICES(value_first, BLOCKS) INDICES(value_second, BLOCKS) INDICES(pair_first, ALL_PAIRS)
        INDICES(pair_second, ALL_PAIRS) INDICES(at_position, TERMS) INDICES(at_velocity, TERMS)
        INDICES(left, 2 * DENSITIES) INDICES(right, 2 * DENSITIES) INDICES(weight, products) INDICES(term, products)
        || copy_entry(dict, "learns_density", &learns, 1, 8);
    if (!failed && !sound(t)) failed = outside();
    t->learns_density = learns != 0.0;
    PyObject *capsule = failed ? NULL : PyCapsule_New(t, NAME, forget);
    if (capsule == NULL) PyMem_Free(t);
    return capsule;
}

static PyObject *step(PyObject *module, PyObject *args) {
    enum { STATES, VALUE, DENSITY, KNOWN, VALUE_OUT, DENSITY_OUT, NUMBERS_OUT, ARRAYS };
    PyObject *capsule, *array[ARRAYS], *result = NULL;
    if (!PyArg_ParseTuple(args, "OOOOOOOO:step", &capsule, &array[STATES], &array[VALUE], &array[DENSITY],
                          &array[KNOWN], &array[VALUE_OUT], &array[DENSITY_OUT], &array[NUMBERS_OUT]))
        return NULL;
    const Tables *t = tables_in(capsule);
    if (t == NULL) return NULL;
    Py_buffer view[ARRAYS];
    double *scratch = NULL;
    int held = 0;
    for (; held < ARRAYS; held++) {
        int flags = PyBUF_C_CONTIGUOUS | (held >= VALUE_OUT ? PyBUF_WRITABLE : 0);
        if (array[held] == Py_None && held == KNOWN) memset(&view[held], 0, sizeof view[held]);
        else if (PyObject_GetBuffer(array[held], &view[held], flags) < 0) goto done;
    }
    const Py_ssize_t d = sizeof(double), rows = view[STATES].len / (SIZE * d);
    const Py_ssize_t others = rows ? view[KNOWN].len / (rows * SIZE * d) : 0;
    const Py_ssize_t expected[ARRAYS] = {
        rows * SIZE, rows * 2 * VALUES, rows * 2 * DENSITIES, rows * others * SIZE,
        rows * 2 * VALUES, rows * 2 * DENSITIES, rows * NUMBERS,
    };
    for (int k = 0; k < ARRAYS; k++)
        if (view[k].len != expected[k] * d || (view[k].buf != NULL && view[k].itemsize != d)) {
            PyErr_Format(PyExc_ValueError, "array %d has %zd bytes, expected %zd", k, view[k].len, expected[k] * d);
            goto done;
        }
    if (!t->learns_density) {
        if (rows && !others) {
            PyErr_SetString(PyExc_ValueError, "hjb needs the states its rows know");
            goto done;
        }
        scratch = PyMem_Malloc((others ? others : 1) * d);
        if (scratch == NULL) {
            PyErr_NoMemory();
            goto done;
        }
    }
    const double *states = view[STATES].buf, *known = view[KNOWN].buf;
    double *numbers = view[NUMBERS_OUT].buf;
    for (Py_ssize_t m = 0; m < rows && !t->learns_density; m++)
        numbers[m * NUMBERS + 4] = empirical(t, states + m * SIZE, known + m * others * SIZE, others, scratch);
    const Rows all = {view[STATES].buf, view[VALUE].buf, view[DENSITY].buf,
                      view[VALUE_OUT].buf, view[DENSITY_OUT].buf, view[NUMBERS_OUT].buf};
    step_rows(t, &all, rows);
    double largest = 0.0; /* and what is not a number stays so */
    for (Py_ssize_t k = 0; k < rows * NUMBERS && largest == largest; k++) {
        double size = fabs(numbers[k]);
        if (!(size <= largest)) largest = size;
    }
    result = PyFloat_FromDouble(largest);
done:
    PyMem_Free(scratch);
    while (held--)
        if (view[held].obj != NULL) PyBuffer_Release(&view[held]);
    return result;
}

static PyMethodDef methods[] = {
    {"tables", tables, METH_O, "Tables of a scenario, from a dict of arrays; checked once."},
    {"step", step, METH_VARARGS,
     "step(tables, states, value, density, known | None, value_out, density_out, numbers_out)\n\n"
     "All float64, rows first. Returns the largest of the numbers, or NaN."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "_kernel", "The learners' tick, compiled.", 0, methods};

PyMODINIT_FUNC PyInit__kernel(void) {
#if MANY > 1
    if (__builtin_cpu_supports("avx2")) lanes = MANY;
#endif
    return PyModule_Create(&definition);
}
