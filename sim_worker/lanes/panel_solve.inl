// Triangular solves L y = b, L^T x = y with a factor in panels (panel_solve.h), one environment per
// lane: included by lane_kernel.inl. Value is Lane3 where the three components of a point have one
// factor, Lane where every component is a row of its own. The columns of a panel stay in registers
// while its rows are read once (docs/tissue.md 11.2: a solve by single columns is bound by the
// cache).

namespace {

using omentum::FactorPanel;
using omentum::PanelArgs;

inline void load_row(const Real* b, std::int32_t row, Lane& v) { v = load(b + kLanes * row); }
inline void load_row(const Real* b, std::int32_t row, Lane3& v) { v = load3(b + 3 * kLanes * row); }
inline void store_row(Real* b, std::int32_t row, Lane v) { store(b + kLanes * row, v); }
inline void store_row(Real* b, std::int32_t row, Lane3 v) { store3(b + 3 * kLanes * row, v); }

template <typename Value, int kWidth>
inline void forward_panel(const PanelArgs<Real>& args, const FactorPanel& panel, Real* b) {
  const std::int32_t* const row = args.row + panel.row_begin;
  const Real* value = args.value + panel.value_begin;
  Value y[kWidth];
  for (int k = 0; k < kWidth; ++k) {
    load_row(b, row[k], y[k]);
    for (int j = 0; j < k; ++j) y[k] = fnma(splat(value[kWidth * k + j]), y[j], y[k]);
    y[k] = splat(value[kWidth * k + k]) * y[k];
    store_row(b, row[k], y[k]);
  }
  value += kWidth * kWidth;
  for (int r = 0; r < panel.rows; ++r, value += kWidth) {
    Value t;
    load_row(b, row[kWidth + r], t);
    for (int k = 0; k < kWidth; ++k) t = fnma(splat(value[k]), y[k], t);
    store_row(b, row[kWidth + r], t);
  }
}

template <typename Value, int kWidth>
inline void backward_panel(const PanelArgs<Real>& args, const FactorPanel& panel, Real* b) {
  const std::int32_t* const row = args.row + panel.row_begin;
  const Real* const block = args.value + panel.value_begin;
  const Real* value = block + kWidth * kWidth;
  Value y[kWidth];
  for (int k = 0; k < kWidth; ++k) load_row(b, row[k], y[k]);
  for (int r = 0; r < panel.rows; ++r, value += kWidth) {
    Value t;
    load_row(b, row[kWidth + r], t);
    for (int k = 0; k < kWidth; ++k) y[k] = fnma(splat(value[k]), t, y[k]);
  }
  for (int k = kWidth - 1; k >= 0; --k) {
    for (int j = k + 1; j < kWidth; ++j) y[k] = fnma(splat(block[kWidth * j + k]), y[j], y[k]);
    y[k] = splat(block[kWidth * k + k]) * y[k];
    store_row(b, row[k], y[k]);
  }
}

template <typename Value, bool kForward>
inline void solve_panel(const PanelArgs<Real>& args, const FactorPanel& panel, Real* b) {
  switch (panel.width) {
    case 1:
      return kForward ? forward_panel<Value, 1>(args, panel, b)
                      : backward_panel<Value, 1>(args, panel, b);
    case 2:
      return kForward ? forward_panel<Value, 2>(args, panel, b)
                      : backward_panel<Value, 2>(args, panel, b);
    case 3:
      return kForward ? forward_panel<Value, 3>(args, panel, b)
                      : backward_panel<Value, 3>(args, panel, b);
    default:
      return kForward ? forward_panel<Value, 4>(args, panel, b)
                      : backward_panel<Value, 4>(args, panel, b);
  }
}

template <typename Value>
void solve_panels(const PanelArgs<Real>& args, Real* b) {
  for (int p = 0; p < args.panels; ++p) solve_panel<Value, true>(args, args.panel[p], b);
  for (int p = args.panels - 1; p >= 0; --p) solve_panel<Value, false>(args, args.panel[p], b);
}

}  // namespace
