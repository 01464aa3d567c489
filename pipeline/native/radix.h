// Sorting by whole numbers of known length.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

// Sorts items by bits of a number that `key_of` takes from each, from one bit on up to another: eleven at a time, which
// keeps what is equal in its order.
template <class Item, class Key> void radix_sort(std::vector<Item> &items, int from_bit, int to_bit, Key key_of) {
    constexpr int DIGIT_BITS = 11;
    constexpr uint64_t DIGIT = (1 << DIGIT_BITS) - 1;
    std::vector<Item> sorted(items.size());
    for (int shift = from_bit; shift < to_bit; shift += DIGIT_BITS) {
        uint32_t begins[DIGIT + 1] = {};
        for (const Item &item : items) begins[(key_of(item) >> shift) & DIGIT]++;
        uint32_t begin = 0;
        for (uint32_t &of_digit : begins) begin += std::exchange(of_digit, begin);
        for (const Item &item : items) sorted[begins[(key_of(item) >> shift) & DIGIT]++] = item;
        items.swap(sorted);
    }
}
