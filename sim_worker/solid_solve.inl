// Triangular solves of the elastic solid's preconditioner: included by solid_kernel.inl. The factor
// is over single components, row 3 i + axis of node i, so that it knows how they pull at each other
// (elastic_kernel.inl solves the three alike). Panels: elastic_kernel.h.

namespace {

template <int kWidth>
inline void forward_panel(const Args& args, const omentum::FactorPanel& panel, Real* b) {
  const std::int32_t* const row = args.panel_row + panel.node_begin;
  const Real* value = args.panel_value + panel.value_begin;
  Lane y[kWidth];
  for (int k = 0; k < kWidth; ++k) {
    y[k] = load(b + kLanes * row[k]);
    for (int j = 0; j < k; ++j) y[k] = fnma(splat(value[kWidth * k + j]), y[j], y[k]);
    y[k] = splat(value[kWidth * k + k]) * y[k];
    store(b + kLanes * row[k], y[k]);
  }
  value += kWidth * kWidth;
  for (int r = 0; r < panel.rows; ++r, value += kWidth) {
    Real* const memory = b + kLanes * row[kWidth + r];
    Lane t = load(memory);
    for (int k = 0; k < kWidth; ++k) t = fnma(splat(value[k]), y[k], t);
    store(memory, t);
  }
}

template <int kWidth>
inline void backward_panel(const Args& args, const omentum::FactorPanel& panel, Real* b) {
  const std::int32_t* const row = args.panel_row + panel.node_begin;
  const Real* const block = args.panel_value + panel.value_begin;
  const Real* value = block + kWidth * kWidth;
  Lane y[kWidth];
  for (int k = 0; k < kWidth; ++k) y[k] = load(b + kLanes * row[k]);
  for (int r = 0; r < panel.rows; ++r, value += kWidth) {
    const Lane t = load(b + kLanes * row[kWidth + r]);
    for (int k = 0; k < kWidth; ++k) y[k] = fnma(splat(value[k]), t, y[k]);
  }
  for (int k = kWidth - 1; k >= 0; --k) {
    for (int j = k + 1; j < kWidth; ++j) y[k] = fnma(splat(block[kWidth * j + k]), y[j], y[k]);
    y[k] = splat(block[kWidth * k + k]) * y[k];
    store(b + kLanes * row[k], y[k]);
  }
}

void solve_components(const Args& args, Real* b) {
  for (int p = 0; p < args.panels; ++p) {
    const omentum::FactorPanel& panel = args.panel[p];
    switch (panel.width) {
      case 1:
        forward_panel<1>(args, panel, b);
        break;
      case 2:
        forward_panel<2>(args, panel, b);
        break;
      case 3:
        forward_panel<3>(args, panel, b);
        break;
      default:
        forward_panel<4>(args, panel, b);
    }
  }
  for (int p = args.panels - 1; p >= 0; --p) {
    const omentum::FactorPanel& panel = args.panel[p];
    switch (panel.width) {
      case 1:
        backward_panel<1>(args, panel, b);
        break;
      case 2:
        backward_panel<2>(args, panel, b);
        break;
      case 3:
        backward_panel<3>(args, panel, b);
        break;
      default:
        backward_panel<4>(args, panel, b);
    }
  }
}

}  // namespace
