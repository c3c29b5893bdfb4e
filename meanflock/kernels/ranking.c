/* Compiled form of ranking.py. */
#include "module.h" /* Python.h comes first */

#include <string.h>

/* Puts the numbers of the nearest objects of a row of n into `found`, at most `most`; returns how many there are. */
static Py_ssize_t nearest_first(const char *distance, Py_ssize_t n, double reach, Py_ssize_t most, double *near,
                                int64_t *found) {
    Py_ssize_t count = 0;
    for (Py_ssize_t j = 0; j < n; j++) {
        double apart;
        memcpy(&apart, distance + j * D, D); /* it may be unaligned */
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
