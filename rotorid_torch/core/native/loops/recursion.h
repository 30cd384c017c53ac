// Recursions over records: y[k] = step(y[k-1], u[k]), W series in lanes, threads over groups of W.
// Needs step<T> (the value, then its derivatives by y[k-1] and by each input), prepare, NU.

// An input of a batch of series: values [batch, samples or 1, columns], strides in doubles, 0 for what does not vary.
struct Input {
  const double* values;
  int64_t batch, sample;
};

// Series `first` to `first + used` of the columns of all batches: y [batch, samples, columns], start [batch, columns];
// slopes: 1 + NU arrays like y.
static void follow_group(int64_t first, int used, int64_t columns, int64_t samples, const Input* u, const double* start,
                         const double* c, double* y, double* const* slopes) {
  const double* from[NU][W];
  size_t place[W];
  vd last, now[NU], out[2 + NU];
  for (int l = 0; l < W; l++) {
    const int64_t series = first + (l < used ? l : 0), batch = series / columns, column = series % columns;
    for (int i = 0; i < NU; i++) from[i][l] = u[i].values + batch * u[i].batch + column;
    place[l] = (size_t)(batch * samples * columns + column);
    last[l] = start[series];
  }
  for (int64_t k = 0; k < samples; k++) {
    for (int i = 0; i < NU; i++) for (int l = 0; l < W; l++) now[i][l] = from[i][l][k * u[i].sample];
    step(&last, now, c, out);
    last = out[0];
    for (int l = 0; l < used; l++) {
      const size_t here = place[l] + (size_t)(k * columns);
      y[here] = out[0][l];
      for (int i = 0; i <= NU; i++) slopes[i][here] = out[1 + i][l];
    }
  }
}

extern "C" void follow(int64_t series, int64_t columns, int64_t samples, const Input* u, const double* start,
                       const double* th, double* y, double* const* slopes, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  each_group(series, threads, [&](int64_t first, int used) {
    follow_group(first, used, columns, samples, u, start, c.data(), y, slopes);
  });
}
