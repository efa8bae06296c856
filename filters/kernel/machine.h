/* Whether this compiler can make code for newer x86-64 machines than the one that it assumes, and how to ask for it. */
#ifndef USBLDR_MACHINE_H
#define USBLDR_MACHINE_H
#if defined(__x86_64__) && defined(__GNUC__) && !defined(PORTABLE_ALONE) /* the macro: to compile in less time */
#define X86_VARIANTS
#include <math.h> /* before the target: what the system declares is no part of it */
#include <stdlib.h>
#include <string.h>
#include "layout.h"
#define PRAGMA(text) _Pragma(#text)
#ifdef __clang__
#define TARGET(name) PRAGMA(clang attribute push(__attribute__((target(name))), apply_to = function))
#define END_TARGET PRAGMA(clang attribute pop)
#else
#define TARGET(name) PRAGMA(GCC push_options) PRAGMA(GCC target(name))
#define END_TARGET PRAGMA(GCC pop_options)
#endif
#endif
#endif
