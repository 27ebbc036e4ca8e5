#pragma once

#include <cstddef>
#include <new>
#include <vector>

namespace omentum {

/// Allocator whose blocks start on a cache line, so that vector loads never straddle one.
template <typename T>
struct CacheLineAllocator {
  using value_type = T;
  static constexpr std::align_val_t kAlignment{64};

  CacheLineAllocator() = default;
  template <typename U>
  CacheLineAllocator(const CacheLineAllocator<U>&) {}  // NOLINT(google-explicit-constructor)

  T* allocate(std::size_t count) {
    return static_cast<T*>(::operator new(count * sizeof(T), kAlignment));
  }
  void deallocate(T* memory, std::size_t) { ::operator delete(memory, kAlignment); }
  friend bool operator==(const CacheLineAllocator&, const CacheLineAllocator&) { return true; }
};

/// Numbers on cache lines: what vector code reads and writes.
template <typename T>
using AlignedVector = std::vector<T, CacheLineAllocator<T>>;

/// Scratch, packed weights, gradients.
using AlignedFloats = AlignedVector<float>;

}  // namespace omentum
