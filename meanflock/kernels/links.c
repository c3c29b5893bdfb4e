/* Compiled form of links.py. */
#include "module.h" /* Python.h comes first */

static int32_t short_at(const char *array, Py_ssize_t place) {
    int32_t number;
    memcpy(&number, array + place * sizeof number, sizeof number);
    return number;
}

PyObject *links_pick(PyObject *module, PyObject *args) {
    PyObject *links, *chosen, *picked, *used;
    Arrays arrays = {.held = 0};
    int32_t *number; /* of each frame among those that are used; first, whether it is used */
    if (!PyArg_ParseTuple(args, "OOOO:pick", &links, &chosen, &picked, &used)) return NULL;
    const Py_buffer *from = hold(&arrays, links, "links", "il", 4, READ);
    const Py_ssize_t count = from == NULL ? 0 : from->len / 8;
    const Py_buffer *to = !sized(from, "links", count * 8) ? NULL : hold(&arrays, picked, "picked", "il", 4, WRITTEN);
    const Py_buffer *rows = !sized(to, "picked", count * 8) ? NULL : hold(&arrays, used, "used", "lq", D, WRITTEN);
    if (rows == NULL) return done(&arrays, NULL);
    const Py_ssize_t frames = rows->len / D;
    const char *is_chosen = NULL;
    if (chosen != Py_None) {
        const Py_buffer *mask = hold(&arrays, chosen, "chosen", "?", 1, READ);
        if (!sized(mask, "chosen", count)) return done(&arrays, NULL);
        is_chosen = mask->buf;
    }
    if ((number = (int32_t *)room_for(&arrays, frames / 2 + 1)) == NULL) return done(&arrays, NULL);
    memset(number, 0, frames * sizeof *number);
    for (Py_ssize_t k = 0; k < count; k++) {
        const int32_t frame = short_at(from->buf, 2 * k);
        if (is_chosen != NULL && !is_chosen[k]) continue;
        if (frame < 0 || frame >= frames) {
            PyErr_SetString(PyExc_ValueError, "links: a frame that there is not");
            return done(&arrays, NULL);
        }
        number[frame] = 1;
    }
    int64_t found = 0;
    for (int64_t frame = 0; frame < frames; frame++) {
        if (!number[frame]) continue;
        memcpy((char *)rows->buf + found * D, &frame, D);
        number[frame] = (int32_t)found++;
    }
    Py_ssize_t kept = 0;
    for (Py_ssize_t k = 0; k < count; k++) {
        if (is_chosen != NULL && !is_chosen[k]) continue;
        const int32_t link[2] = {number[short_at(from->buf, 2 * k)], short_at(from->buf, 2 * k + 1)};
        memcpy((char *)to->buf + kept++ * sizeof link, link, sizeof link);
    }
    return done(&arrays, Py_BuildValue("nL", kept, (long long)found));
}
