// Unscented filter and smoother of the model that stands before: rates, outputs, step.
//
// With the prior's root X (columns X_j, reach g, weight w of a point) the outputs at the points give
//   D_j = w g (h(x + g X_j) - h(x - g X_j)),   E_j = sqrt(w / 2) (h(x + g X_j) + h(x - g X_j) - 2 y),
// so that cov(x, y) = sum X_j D_j' and S = D'D + rest, rest = E'E + centre + R. With rest = V'V and G = D V^-1 the
// posterior is X (1 + G G')^-1 X': its root comes from the factor of 1 + G G' and that of rest, nothing is subtracted
// from a covariance, and the root is at hand for the next sigma points. The same D and E of the next state give the
// prediction and the smoother's gain. Sources: Julier and Uhlmann 2004; Sarkka 2008; the square-root information form
// of the update: Maybeck, Stochastic Models, Estimation, and Control 1, ch. 7.
//
// One flight: sigma points lie in lanes. Several: W flights lie in lanes.
#pragma once
#include <cstdlib>
#include <new>
#include "matrices.h"
#include "step.h"

struct Settings { double dt, parts, reach, centre, other; };  // steps of a sample; weights: the centre's in covariances, each other point's
struct Task {  // arrays in C order; flights F, samples T
  int64_t flights, samples, entries, noise_flights, noise_samples;
  const double *controls, *outputs, *mean, *covariance, *R, *noise, *numbers;
  const int64_t *row, *column;  // where the entries of the process noise stand, row <= column
  double *means, *covariances, *innovations, *spreads, *likelihood, *smoothed_means, *smoothed_covariances;
};

// The model, one copy of its code for all that need it.
[[gnu::noinline]] static void see(const vd* x, const vd* u, const double* c, vd* y) { outputs(x, u, c, y); }
[[gnu::noinline]] static void move(const vd* x, const vd* u0, const vd* u1, double dt, int parts, const double* c, vd* out) {
  if (parts == 1) return step(x, u0, u1, dt, c, out);
  vd at[NX], a[NU + 1], b[NU + 1];
  for (int i = 0; i < NX; i++) out[i] = x[i];
  for (int k = 0; k < parts; k++) {
    for (int i = 0; i < NX; i++) at[i] = out[i];
    for (int i = 0; i < NU; i++) a[i] = u0[i] + k * (1.0 / parts) * (u1[i] - u0[i]), b[i] = u0[i] + (k + 1) * (1.0 / parts) * (u1[i] - u0[i]);
    step(at, a, b, dt / parts, c, out);
  }
}

template <class T> struct Filter {
  enum { LX = vectors<T>(NX), LY = vectors<T>(NY), LR = vectors<T>(NX + 1), LE = vectors<T>(NY + 1), LA = LE + LX };
  enum { NS = 2 * NX + 1, LP = vectors<double>(NS) };
  const Settings& set;
  const Task& task;
  const size_t first, count;  // flights
  vd P[NX][LX] = {}, U[NX][LR] = {}, ahead[NS][LX] = {}, seen[NS][LY] = {}, rest[NY][LA] = {}, S[NY][LY] = {};
  vd information[NX][LX] = {}, S_X[NX][LX] = {}, gain[NX][LX] = {}, pieces[2 * NX][LX] = {}, root[NX][LX] = {};
  vd mean[LX] = {}, moved[LX] = {}, expected[LY] = {};
  double points[NX][LP * W] = {}, images[NX > NY ? NX : NY][LP * W] = {};
  double c[NC];  // the model's numbers

  Filter(const Settings& set, const Task& task, size_t first, size_t count) : set(set), task(task), first(first), count(count) {
    prepare(task.numbers, c);
  }

  // --- numbers of these flights in and out; `stride` from one flight to the next; lanes to spare repeat the last flight
  T load(const double* p, size_t stride) const {
    if constexpr (PER<T> > 1) return p[first * stride];
    else {
      T v;
      for (size_t l = 0; l < W; l++) v[l] = p[(first + (l < count ? l : count - 1)) * stride];
      return v;
    }
  }
  void store(double* p, size_t stride, T v) const {
    if constexpr (PER<T> > 1) p[first * stride] = v;
    else for (size_t l = 0; l < count; l++) p[(first + l) * stride] = v[l];
  }
  template <int N, int L> [[gnu::noinline]] void store_symmetric(double* p, size_t stride, const vd (*A)[L]) const {
    auto entry = [&](int n) { const int i = n / N, j = n % N; return numbers<T>(A[i < j ? i : j])[i < j ? j : i]; };
    if constexpr (PER<T> > 1) {
      p += first * stride;
      for (int i = 0; i < N; i++)
        for (int j = i; j < N; j++) p[i * N + j] = p[j * N + i] = numbers<T>(A[i])[j];
    } else {
      constexpr int whole = N * N / W * W;
      for (int n = 0; n < whole; n += W) {  // W neighbours of each lane at a time
        vd block[W];
        for (int q = 0; q < W; q++) block[q] = entry(n + q);
        transpose(block);
        for (size_t l = 0; l < count; l++) memcpy(p + (first + l) * stride + n, block + l, sizeof(vd));
      }
      for (int n = whole; n < N * N; n++) store(p + n, stride, entry(n));
    }
  }
  void controls(size_t k, vd* u) const {
    for (int i = 0; i < NU; i++) u[i] = vd{} + load(task.controls + k * NU + i, task.samples * NU);
  }

  // --- Z: rows D_j, E_j and the centre's; mean, as the centre's image and a shift (exact where all agree), of the images of the sigma points x, x +- reach rows of U under `map`
  template <int N, int L, class Map> void spread(const Map& map, vd (*Z)[L], vd* middle) {
    const double odd = set.other * set.reach, even = __builtin_sqrt(0.5 * set.other), middle_root = __builtin_sqrt(set.centre);
    T* m = numbers<T>(middle);
    if constexpr (PER<T> == 1) {
      vd point[NX], centre[N], image[2][N], sum[N] = {};
      map(mean, centre);
      for (int s = 0; s < 2 * NX; s++) {  // + and - of each pair in turn
        const int j = s / 2;
        const double reach = s % 2 ? -set.reach : set.reach;
        for (int i = 0; i < NX; i++) point[i] = i < j ? mean[i] : mean[i] + reach * U[j][i];
        map(point, image[s % 2]);
        if (s % 2)
          for (int i = 0; i < N; i++) {
            Z[j][i] = odd * (image[0][i] - image[1][i]);
            sum[i] += Z[NX + j][i] = (image[0][i] - centre[i]) + (image[1][i] - centre[i]);
          }
      }
      for (int i = 0; i < N; i++) {
        const vd shift = set.other * sum[i];
        m[i] = centre[i] + shift;
        Z[2 * NX][i] = -middle_root * shift;
        for (int j = 0; j < NX; j++) Z[NX + j][i] = even * (Z[NX + j][i] - 2.0 * shift);
      }
    } else {
      lay_out();
      for (int b = 0; b < LP; b++) {
        vd in[NX], out[N];
        for (int i = 0; i < NX; i++) in[i] = ((vd*)points[i])[b];
        map(in, out);
        for (int i = 0; i < N; i++) ((vd*)images[i])[b] = out[i];
      }
      for (int i = 0; i < N; i++) {
        const double* y = images[i];
        const double centre = y[2 * NX];
        double sum = 0.0;
        for (int s = 0; s < 2 * NX; s++) sum += y[s] - centre;
        const double shift = set.other * sum;
        m[i] = centre + shift;
        numbers<T>(Z[2 * NX])[i] = -middle_root * shift;
        for (int j = 0; j < NX; j++) {
          numbers<T>(Z[j])[i] = odd * (y[j] - y[NX + j]);
          numbers<T>(Z[NX + j])[i] = even * ((y[j] - centre) + (y[NX + j] - centre) - 2.0 * shift);
        }
      }
    }
  }
  void lay_out() {  // sigma points of one flight: first +, then -, then the centre and copies of it
    for (int i = 0; i < NX; i++) {
      const double x = numbers<double>(mean)[i];
      for (int b = 0; b < LP; b++) ((vd*)points[i])[b] = vd{} + x;
      for (int j = 0; j <= i; j++) {
        const double offset = set.reach * numbers<double>(U[j])[i];
        points[i][j] = x + offset, points[i][NX + j] = x - offset;
      }
    }
  }

  // --- measurement at sample k: mean and U become those of the posterior, P its covariance
  T update(size_t k) {
    vd u[NU + 1];
    controls(k, u);
    spread<NY>([&](const vd* x, vd* y) { see(x, u, c, y); }, seen, expected);
    squares<T, NY>(rest, seen + NX, NX + 1);
    for (int i = 0; i < NY; i++)
      for (int j = i; j < NY; j++) numbers<T>(rest[i])[j] += task.R[i * NY + j];
    if (task.spreads) {
      for (int i = 0; i < NY; i++) for (int b = i / PER<T>; b < LY; b++) S[i][b] = rest[i][b];
      squares<T, NY>(S, seen, NX, ADD);
      store_symmetric<NY>(task.spreads + k * NY * NY, task.samples * NY * NY, S);
    }
    T number = T() + double(NY), zero[NY] = {};
    for (int i = 0; i < NY; i++) {
      T* row = numbers<T>(rest[i]);
      for (int j = 0; j < NX; j++) row[LE * PER<T> + j] = numbers<T>(seen[j])[i];
      row[NY] = load(task.outputs + k * NY + i, task.samples * NY) - numbers<T>(expected)[i];
      store(task.innovations + k * NY + i, task.samples * NY, row[NY]);
    }
    leave_out_missing(number);
    eliminate<T, NY, LA>(rest, zero);
    squares<T, NX>(information, (const vd(*)[LA])((vd*)rest + LE), NY, SET, LOWER);
    T shift[NX] = {};
    for (int i = 0; i < NX; i++) {
      numbers<T>(information[i])[i] += 1.0;
      for (int m = 0; m < NY; m++) shift[i] += numbers<T>(rest[m])[LE * PER<T> + i] * numbers<T>(rest[m])[NY];
      numbers<T>(U[i])[NX] = shift[i];
    }
    eliminate_upwards<T, NX>(information, U);
    squares<T, NX>(P, U, NX, SET, UPPER, UP_TO_ROW);
    return correct(number);
  }
  // what a missing output says: nothing, with variance one
  void leave_out_missing(T& number) {
    T present[NY], all = T() + 1.0;
    for (int i = 0; i < NY; i++) {
      const T e = numbers<T>(rest[i])[NY];
      present[i] = e == e ? T() + 1.0 : T();
      all *= present[i];
    }
    if constexpr (PER<T> > 1) { if (all == 1.0) return; }
    else {
      bool every = true;
      for (int l = 0; l < W; l++) every = every && all[l] == 1.0;
      if (every) return;
    }
    number = T();
    for (int i = 0; i < NY; i++) {
      T* row = numbers<T>(rest[i]);
      number += present[i];
      for (int j = i; j < NY; j++) row[j] *= present[i] * present[j];
      row[i] += 1.0 - present[i];
      row[NY] = present[i] > 0.0 ? row[NY] : T();
      for (int b = LE; b < LA; b++) rest[i][b] *= present[i];
    }
  }
  // mean of the posterior; returns the log-likelihood of the innovation, as the sum of what the state takes up and leaves
  T correct(T number) {
    T z[NX], inverse[NX], quadratic = T();  // z: change of the state in units of the prior's root
    vd change[LX] = {};
    for (int j = 0; j < NX; j++) {
      const T v = numbers<T>(U[j])[NX];
      for (int b = j / PER<T>; b < LX; b++) change[b] += v * U[j][b];
    }
    // V^-T v: back from the posterior's to the prior's root
    for (int i = 0; i < NX; i++) z[i] = numbers<T>(U[i])[NX], inverse[i] = 1.0 / numbers<T>(information[i])[i];
    for (int m = 0; m < NX; m++) {
      z[m] *= inverse[m];
      quadratic += z[m] * z[m];
      for (int i = m + 1; i < NX; i++) z[i] -= numbers<T>(information[i])[m] * z[m];
    }
    for (int m = 0; m < NY; m++) {
      const T* row = numbers<T>(rest[m]);
      T left = row[NY];
      for (int j = 0; j < NX; j++) left -= row[LE * PER<T> + j] * z[j];
      quadratic += left * left;
    }
    for (int b = 0; b < LX; b++) mean[b] += change[b];
    const T logarithm = log_diagonal<T, NY>(rest) + log_diagonal<T, NX>(information);
    return -0.5 * (quadratic + number * 1.8378770664093453) - logarithm;  // log 2 pi
  }

  // --- prediction from sample k to k + 1: mean and P of the prior there; for the smoother also gain and leak
  void predict(size_t k, vd* memory) {
    vd u0[NU + 1], u1[NU + 1];
    controls(k, u0), controls(k + 1, u1);
    spread<NX>([&](const vd* x, vd* y) { move(x, u0, u1, set.dt, int(set.parts), c, y); }, ahead, moved);
    squares<T, NX>(P, ahead, NS);
    add_noise(k, P);
    if (memory) remember(k, memory);
    for (int b = 0; b < LX; b++) mean[b] = moved[b];
    factor<T, NX>(P, U);
  }
  void add_noise(size_t k, vd (*A)[LX]) const {
    const size_t at = task.noise_samples > 1 ? k * task.entries : 0;
    const size_t stride = task.noise_flights > 1 ? task.noise_samples * task.entries : 0;
    for (int64_t e = 0; e < task.entries; e++)
      numbers<T>(A[task.row[e]])[task.column[e]] += load(task.noise + at + e, stride);
  }

  // --- smoother. Its gain is cross P^-1 with cross = X D'; what the next sample cannot tell of this one (the leak) is
  // the sum of squares of X - gain D' and of gain F, where F F' is the rest of P beside D D'.
  void remember(size_t k, vd* memory) {
    multiply<T, NX>(pieces, U, true, ahead, NX, SET, UP_TO_ROW);
    for (int i = 0; i < NX; i++)
      for (int j = 0; j < NX; j++) numbers<T>(gain[j])[i] = numbers<T>(pieces[i])[j];  // transposed, as all below
    squares<T, NX>(S_X, ahead + NX, NX + 1);
    add_noise(k, S_X);
    factor<T, NX>(P, root);
    divide<T, NX>(gain, root);
    for (int j = 0; j < NX; j++) for (int b = 0; b < LX; b++) pieces[j][b] = U[j][b];
    multiply<T, NX>(pieces, ahead, false, gain, NX, SUBTRACT, ALL);
    factor<T, NX>(S_X, root);
    multiply<T, NX>(pieces + NX, root, false, gain, NX, SET, FROM_ROW);
    squares<T, NX>(S_X, pieces, 2 * NX);
    for (int b = 0; b < LX; b++) *memory++ = moved[b];
    for (int i = 0; i < NX; i++) for (int b = 0; b < LX; b++) *memory++ = gain[i][b];
    for (int i = 0; i < NX; i++) for (int b = i / PER<T>; b < LX; b++) *memory++ = S_X[i][b];
  }
  static constexpr size_t memory_size() {  // vectors a sample
    size_t size = LX + NX * LX;
    for (int i = 0; i < NX; i++) size += LX - i / PER<T>;
    return size;
  }
  // mean and P of sample k given all outputs, from those of sample k + 1
  void look_back(size_t k, const vd* memory) {
    const vd *predicted = memory, *leak = memory + LX + NX * LX;
    for (int i = 0; i < NX; i++) for (int b = 0; b < LX; b++) gain[i][b] = memory[LX + i * LX + b];
    for (int b = 0; b < LX; b++) moved[b] = mean[b] - predicted[b];
    for (int i = 0; i < NX; i++) numbers<T>(mean)[i] = load(task.means + k * NX + i, task.samples * NX);
    for (int j = 0; j < NX; j++) {
      const T change = numbers<T>(moved)[j];
      for (int b = 0; b < LX; b++) mean[b] += change * gain[j][b];
    }
    factor<T, NX>(P, root);
    multiply<T, NX>(pieces, root, false, gain, NX, SET, FROM_ROW);
    for (int i = 0; i < NX; i++) for (int b = i / PER<T>; b < LX; b++) P[i][b] = *leak++;
    squares<T, NX>(P, pieces, NX, ADD);
  }

  void start() {
    for (int i = 0; i < NX; i++) {
      numbers<T>(mean)[i] = load(task.mean + i, NX);
      for (int j = i; j < NX; j++) numbers<T>(P[i])[j] = load(task.covariance + i * NX + j, NX * NX);
    }
    factor<T, NX>(P, U);
  }
  void write(size_t k, double* means, double* covariances) const {
    for (int i = 0; i < NX; i++) store(means + k * NX + i, task.samples * NX, numbers<T>(mean)[i]);
    store_symmetric<NX>(covariances + k * NX * NX, task.samples * NX * NX, P);
  }
  void run(vd* memory) {
    T likelihood = T();
    start();
    const size_t last = task.samples - 1, size = memory_size();
    for (size_t k = 0; k <= last; k++) {
      likelihood += update(k);
      write(k, task.means, task.covariances);
      if (k < last) predict(k, memory ? memory + k * size : nullptr);
    }
    store(task.likelihood, 1, likelihood);
    if (!task.smoothed_means) return;
    write(last, task.smoothed_means, task.smoothed_covariances);
    for (size_t k = last; k-- > 0;) {
      look_back(k, memory + k * size);
      write(k, task.smoothed_means, task.smoothed_covariances);
    }
  }
};

// The flights of one job: W in lanes, or one alone. Which way depends on their number only, never on the threads.
template <class T> static void run_flights(const Settings& set, const Task& task, size_t first, size_t count) {
  struct Memory { vd* at = nullptr; ~Memory() { std::free(at); } } memory;
  if (task.smoothed_means) {
    const size_t bytes = Filter<T>::memory_size() * task.samples * sizeof(vd);
    memory.at = (vd*)std::aligned_alloc(sizeof(vd), bytes);
    if (!memory.at) throw std::bad_alloc();
  }
  struct Owner { Filter<T>* const filter; ~Owner() { delete filter; } } const one{new Filter<T>(set, task, first, count)};
  one.filter->run(memory.at);
}

// 0, or 1 where memory did not suffice.
extern "C" int unscented(const Settings* set, const Task* task, int threads) {
  const size_t flights = task->flights, rest = flights % W, alone = rest == 1 || 2 * rest < W ? rest : 0;
  const size_t full = (flights - alone + W - 1) / W, jobs = full + alone;
  int failed = 0;
  each((int64_t)jobs, threads, [&](size_t job) {
    try {
      const size_t first = job < full ? job * W : flights - alone + (job - full);
      if (job < full) run_flights<vd>(*set, *task, first, flights - alone - first < W ? flights - alone - first : W);
      else run_flights<double>(*set, *task, first, 1);
    } catch (const std::bad_alloc&) { __atomic_store_n(&failed, 1, __ATOMIC_RELAXED); }
  });
  return failed;
}
