// One Runge-Kutta step of the model, controls linear within it, or with HOLD as they were at its start. The 3/8 rule is torchdiffeq's "rk4" (Kutta 1901).
#pragma once
static const double NODE[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};
template <int g, class T> static inline T stage(const T& x, const T& a, const T& b, const T& c, double dt) {
  if constexpr (g == 1) return x + (dt / 3.0) * a;
  if constexpr (g == 2) return x + dt * (b - a * (1.0 / 3.0));
  if constexpr (g == 3) return x + dt * (a - b + c);
  return x;
}
template <class T> static inline T advanced(const T& x, const T& a, const T& b, const T& c, const T& d, double dt) {
  return x + (a + 3.0 * (b + c) + d) * (dt / 8.0);
}

#ifdef HOLD  // controls stay as they are within a step
#define SHARE(g) 0.0
#else
#define SHARE(g) NODE[g]
#endif

// The step from x to `out`; slope(z, g, k) gives the rates k at the state z of stage g.
template <class T, class Slope> static inline void runge_kutta(const T* x, double dt, Slope slope, T* out) {
  T k[4][NX], z[NX];
  slope(x, 0, k[0]);
  for (int i = 0; i < NX; i++) z[i] = stage<1>(x[i], k[0][i], k[0][i], k[0][i], dt);
  slope(z, 1, k[1]);
  for (int i = 0; i < NX; i++) z[i] = stage<2>(x[i], k[0][i], k[1][i], k[1][i], dt);
  slope(z, 2, k[2]);
  for (int i = 0; i < NX; i++) z[i] = stage<3>(x[i], k[0][i], k[1][i], k[2][i], dt);
  slope(z, 3, k[3]);
  for (int i = 0; i < NX; i++) out[i] = advanced(x[i], k[0][i], k[1][i], k[2][i], k[3][i], dt);
}

template <class T> static inline void between(const T* u0, const T* u1, int g, T* u) {
  for (int i = 0; i < NU; i++) u[i] = u0[i] + SHARE(g) * (u1[i] - u0[i]);
}

#ifndef LINEARISED  // the loops with derivatives have no rates for vectors
template <class T> static inline void step(const T* x, const T* u0, const T* u1, double dt, const double* c, T* out) {
  T u[NU + 1];
  runge_kutta(x, dt, [&](const T* z, int g, T* k) { between(u0, u1, g, u); rates(z, u, c, k); }, out);
}
#endif
