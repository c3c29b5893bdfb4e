/* Compiled form of links.py. */
#include "module.h" /* Python.h comes first */

typedef struct {
    int32_t frame, uav;
} Link;

static Link link_at(const char *links, Py_ssize_t place) { /* they may begin at any byte */
    Link link;
    memcpy(&link, links + place * sizeof link, sizeof link);
    return link;
}

/* Holds an array of so many links, or of any number of them if that is negative; returns their number, or -1 and sets an
 * exception if it is another. */
static Py_ssize_t hold_links(Arrays *arrays, PyObject *array, const char *name, Py_ssize_t count, int flags) {
    const Py_buffer *view = hold(arrays, array, name, "il", sizeof(int32_t), flags);
    if (count < 0 && view != NULL) count = view->len / (Py_ssize_t)sizeof(Link);
    return sized(view, name, count * (Py_ssize_t)sizeof(Link)) ? count : -1;
}

PyObject *links_pick(PyObject *module, PyObject *args) {
    PyObject *links, *chosen, *picked, *used;
    Arrays arrays = {.held = 0};
    if (!PyArg_ParseTuple(args, "OOOO:pick", &links, &chosen, &picked, &used)) return NULL;
    const Py_ssize_t count = hold_links(&arrays, links, "links", -1, READ);
    if (count < 0 || hold_links(&arrays, picked, "picked", count, WRITTEN) < 0) return done(&arrays, NULL);
    const Py_buffer *of_frames = hold(&arrays, used, "used", "lq", D, WRITTEN), *mask = NULL;
    if (of_frames == NULL) return done(&arrays, NULL);
    if (chosen != Py_None && !sized(mask = hold(&arrays, chosen, "chosen", "?", 1, READ), "chosen", count))
        return done(&arrays, NULL);
    const char *from = arrays.view[0].buf, *is_chosen = mask == NULL ? NULL : mask->buf;
    char *to = arrays.view[1].buf, *numbers = of_frames->buf;
    const Py_ssize_t frames = of_frames->len / D;
    int64_t *place = (int64_t *)room_for(&arrays, frames); /* of each frame among those used; first, whether it is one */
    if (place == NULL) return done(&arrays, NULL);
    memset(place, 0, frames * sizeof *place);
    for (Py_ssize_t k = 0; k < count; k++) {
        const int32_t frame = link_at(from, k).frame;
        if (is_chosen != NULL && !is_chosen[k]) continue;
        if (frame < 0 || frame >= frames) {
            PyErr_SetString(PyExc_ValueError, "links: a frame that there is not");
            return done(&arrays, NULL);
        }
        place[frame] = 1;
    }
    int64_t frames_used = 0;
    for (int64_t frame = 0; frame < frames; frame++) {
        if (!place[frame]) continue;
        memcpy(numbers + frames_used * D, &frame, D);
        place[frame] = frames_used++;
    }
    Py_ssize_t links_picked = 0;
    for (Py_ssize_t k = 0; k < count; k++) {
        if (is_chosen != NULL && !is_chosen[k]) continue;
        Link link = link_at(from, k);
        link.frame = (int32_t)place[link.frame];
        memcpy(to + links_picked++ * sizeof link, &link, sizeof link);
    }
    return done(&arrays, Py_BuildValue("nL", links_picked, (long long)frames_used));
}
