// Trajectories: W of them in lanes, threads over groups of W; nothing depends on the number of threads.
// Needs rates<T>, outputs<T>, prepare.
#include "step.h"

// A state beyond `limit` is held there, and what has no finite rate rests: a run that has diverged says so by its size.
static inline vd held(vd x, double limit) {
  x = x == x ? x : vd{};
  x = x > limit ? lanes(limit) : x;
  return x < -limit ? lanes(-limit) : x;
}
static inline void held_step(const vd* x, const vd* u0, const vd* u1, double dt, const double* c, double limit, vd* out) {
  vd u[NU + 1], inside[NX];
  auto slope = [&](const vd* z, int g, vd* k) {
    for (int i = 0; i < NX; i++) inside[i] = held(z[i], limit);
    between(u0, u1, g, u);
    rates(inside, u, c, k);
    for (int i = 0; i < NX; i++) k[i] = held(k[i], limit);
  };
  runge_kutta(x, dt, slope, out);
}

// u [B, n, NU], x0 [B, NX] -> states [B, n, NX] and, where asked for, y [B, n, NY].
static void group(int lanes_used, int n, double dt, double limit, const double* u, const double* x0, const double* c,
                  double* states, double* y) {
  vd x[NX], u0[NU + 1] = {}, u1[NU + 1] = {}, out[NY + NX];
  const size_t nu = (size_t)n * NU, nx = (size_t)n * NX, ny = (size_t)n * NY;
  auto load = [&](int k, vd* v) {
    for (int l = 0; l < W; l++) for (int i = 0; i < NU; i++) v[i][l] = u[(l < lanes_used ? l : 0) * nu + (size_t)k * NU + i];
  };
  for (int l = 0; l < W; l++) for (int i = 0; i < NX; i++) x[i][l] = x0[(l < lanes_used ? l : 0) * NX + i];
  load(0, u0);
  for (int k = 0; k < n; k++) {
    for (int l = 0; l < lanes_used; l++) for (int i = 0; i < NX; i++) states[l * nx + (size_t)k * NX + i] = x[i][l];
    if (y) {
      outputs(x, u0, c, out);
      for (int l = 0; l < lanes_used; l++) for (int i = 0; i < NY; i++) y[l * ny + (size_t)k * NY + i] = out[i][l];
    }
    if (k == n - 1) return;
    load(k + 1, u1);
    if (limit < __builtin_inf()) held_step(x, u0, u1, dt, c, limit, out); else step(x, u0, u1, dt, c, out);
    memcpy(x, out, sizeof x);
    memcpy(u0, u1, sizeof u0);
  }
}

extern "C" void simulate(int count, int n, double dt, double limit, const double* u, const double* x0, const double* th,
                         double* states, double* y, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  each_group(count, threads, [&](int64_t b, int used) {
    group(used, n, dt, limit, u + b * n * NU, x0 + b * NX, c.data(), states + b * n * NX, y ? y + b * n * NY : nullptr);
  });
}
