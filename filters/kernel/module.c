/* The Python module _kernel: the variants that this machine can run, and the sizes of what they exchange. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include "layout.h"
#include "machine.h"

extern Advance *const advance_portable, *const advance_avx2, *const advance_avx512;

static const struct {
    const char *name;
    Advance *const *advance;
} VARIANTS[] = {
#ifdef X86_VARIANTS
    {"avx512", &advance_avx512}, {"avx2", &advance_avx2},
#endif
    {"portable", &advance_portable}};
enum { COUNT = sizeof VARIANTS / sizeof *VARIANTS };

static int can_run(int variant) {
#ifdef X86_VARIANTS
    __builtin_cpu_init();
    if (variant == 0)
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
               __builtin_cpu_supports("avx512vl");
    if (variant == 1) return __builtin_cpu_supports("avx2") != 0;
#endif
    return variant < COUNT;
}

/* advance(variant, filter, past, count, steps, readings, state, estimates, records) -> status */
static PyObject *py_advance(PyObject *self, PyObject *args) {
    (void)self;
    int variant, past, count;
    Py_buffer part[6];
    if (!PyArg_ParseTuple(args, "iy*iiy*y*w*w*w*", &variant, &part[0], &past, &count, &part[1], &part[2], &part[3],
                          &part[4], &part[5]))
        return NULL;
    const Filter *f = part[0].buf;
    const Step *steps = part[1].buf;
    Py_ssize_t readings = 0, n = 0, N = 0, depth = 0, blocks, tri;
    int good = part[0].len == sizeof(Filter) && part[1].len == (Py_ssize_t)sizeof(Step) * (past + count) &&
               variant >= 0 && variant < COUNT && can_run(variant) && past >= 0 && count >= 0;
    if (good) {
        n = f->n, N = f->N, depth = f->update != DRAWN ? 0 : f->move_steps > 1 ? f->move_steps : 1;
        good = n >= 6 && n <= MAX_STATES && N > 0 && depth <= 4 && past <= depth && f->bias_row < n - 1;
    }
    if (good) {
        Py_ssize_t used = 0;
        for (int s = 0; s < past + count; s++) readings += steps[s].readings, used += s < past ? 0 : steps[s].readings;
        blocks = (N + LANES - 1) / LANES, tri = n + n * (n + 1) / 2;
        good = part[2].len == (Py_ssize_t)sizeof(Reading) * readings &&
               part[3].len == 8 * LANES * blocks * (tri * (1 + depth) + (depth ? 2 + depth : 0)) &&
               part[4].len == 8 * (n + n * n + 2) * count && part[5].len == 8 * (SHIFT + n) * used;
    }
    int status = GOOD;
    if (good)
        status = (*VARIANTS[variant].advance)(f, steps, past, count, part[2].buf, part[3].buf, part[4].buf, part[5].buf);
    for (int i = 0; i < 6; i++) PyBuffer_Release(&part[i]);
    if (good) return PyLong_FromLong(status);
    PyErr_SetString(PyExc_ValueError, "the kernel was given arrays that do not fit together");
    return NULL;
}

static PyMethodDef METHODS[] = {{"advance", py_advance, METH_VARARGS, "Run steps on a bank; see span.h."},
                                {NULL, NULL, 0, NULL}};
static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_kernel", NULL, -1, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) {
    PyObject *module = PyModule_Create(&MODULE), *names = PyList_New(0);
    for (int v = 0; module && names && v < COUNT; v++) {
        PyObject *pair = Py_BuildValue("(si)", VARIANTS[v].name, v);
        if (can_run(v) && pair) PyList_Append(names, pair);
        Py_XDECREF(pair);
    }
    if (module) {
        PyModule_AddObjectRef(module, "VARIANTS", names);
        PyObject *sizes = Py_BuildValue("(iii)", (int)sizeof(Filter), (int)sizeof(Step), (int)sizeof(Reading));
        PyModule_AddObjectRef(module, "SIZES", sizes);
        Py_XDECREF(sizes);
    }
    Py_XDECREF(names);
    return module;
}
