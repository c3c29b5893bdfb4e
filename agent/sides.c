/* What the rows of a process have learned, on two sides: what a tick learns is written to the other one, and is of no
 * use where the tick comes to nothing.
 */
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <structmember.h>

#include "turn.h"

static PyTypeObject *sides_type;

int are_sides(PyObject *object) {
    if (PyObject_TypeCheck(object, sides_type)) return 1;
    PyErr_SetString(PyExc_TypeError, "these are no sides");
    return 0;
}

static void sides_dealloc(PyObject *self) {
    Sides *sides = (Sides *)self;
    PyTypeObject *type = Py_TYPE(self);
    while (sides->views) PyBuffer_Release(&sides->view[--sides->views]);
    Py_XDECREF(sides->capsule);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

/* Value and density of the one side, then those of the other. */
static int take_arrays(Sides *sides, PyObject **array) {
    const Py_ssize_t row[] = {2 * VALUES * sizeof(double), 2 * DENSITIES * sizeof(double)};
    for (int k = 0; k < 4; k++) {
        Py_buffer *view = &sides->view[k];
        if (PyObject_GetBuffer(array[k], view, PyBUF_C_CONTIGUOUS | PyBUF_WRITABLE) < 0) return -1;
        sides->views++;
        if (k == 0) sides->rows = view->len / row[0];
        if (!sides->rows || view->len != sides->rows * row[k % 2] || view->itemsize != sizeof(double)) {
            PyErr_Format(PyExc_ValueError, "array %d: %zd bytes, expected %zd", k, view->len, sides->rows * row[k % 2]);
            return -1;
        }
        (k % 2 ? sides->density : sides->value)[k / 2] = view->buf;
    }
    return 0;
}

static PyObject *sides_new(PyTypeObject *type, PyObject *args, PyObject *named) {
    PyObject *capsule, *array[4];
    double bound;
    if (named != NULL && PyDict_Size(named)) return PyErr_Format(PyExc_TypeError, "Sides takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "OdOOOO:Sides", &capsule, &bound, &array[0], &array[1], &array[2], &array[3]))
        return NULL;
    const Tables *tables = tables_in(capsule);
    if (tables == NULL) return NULL;
    if (!tables->learns_density) return PyErr_Format(PyExc_ValueError, "learners of hjb need the states they know");
    Sides *sides = (Sides *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0); /* all zeros */
    if (sides == NULL) return NULL;
    Py_INCREF(sides->capsule = capsule);
    sides->tables = tables;
    sides->bound = bound;
    if (take_arrays(sides, array) < 0) Py_CLEAR(sides);
    return (PyObject *)sides;
}

static PyMemberDef members[] = {
    {"side", T_INT, offsetof(Sides, side), READONLY, "Where the rows are now: 0 or 1."},
    {NULL, 0, 0, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, "Sides(tables, bound, value, density, other_value, other_density)\n\n"
                "What rows have learned, and as much room. Numbers that come out of a tick are below the bound."},
    {Py_tp_new, sides_new},
    {Py_tp_dealloc, sides_dealloc},
    {Py_tp_members, members},
    {0, NULL},
};

static PyType_Spec spec = {"agent._kernel.Sides", sizeof(Sides), 0, Py_TPFLAGS_DEFAULT, slots};

int add_sides(PyObject *module) {
    PyObject *type = PyType_FromSpec(&spec);
    if (type == NULL) return -1;
    sides_type = (PyTypeObject *)type; /* held for good */
    return PyModule_AddObjectRef(module, "Sides", type);
}
