// Memory of the loops, the set of them that was chosen, and rows shared out to threads.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <memory>
#include <new>
#include <system_error>
#include <thread>
#include <vector>

#include "problem.hpp"

namespace dashpot {

// The loops of the instruction set in use.
const Loops &loops();

// Numbers on the boundaries of cache lines.
struct Free {
    void operator()(void *memory) const { std::free(memory); }
};
template <class T> using Memory = std::unique_ptr<T[], Free>;
template <class T> Memory<T> memory(size_t count) {
    void *place = std::aligned_alloc(64, (std::max<size_t>(count, 1) * sizeof(T) + 63) / 64 * 64);
    if (!place) throw std::bad_alloc();
    return Memory<T>(static_cast<T *>(place));
}

// Rows shared out to threads; each piece gets a workspace of its own.
template <class Work> void share(long rows, int threads, size_t workspace, Work work) {
    threads = static_cast<int>(std::max<long>(1, std::min<long>(threads, rows)));
    if (threads == 1) {
        Memory<char> place = memory<char>(workspace);
        work(0, rows, place.get());
        return;
    }
    const long piece = std::max<long>(1, rows / (8 * threads));
    std::atomic<long> next{0};
    std::vector<Memory<char>> places;
    for (int k = 0; k < threads; ++k) places.push_back(memory<char>(workspace));
    auto run = [&](char *place) {
        for (long from = next.fetch_add(piece); from < rows; from = next.fetch_add(piece))
            work(from, std::min(rows, from + piece), place);
    };
    std::vector<std::thread> team;
    team.reserve(threads);
    try {
        for (int k = 1; k < threads; ++k) team.emplace_back(run, places[k].get());
    } catch (const std::system_error &) {
        // The system allows no more threads: those that there are share all rows.
    }
    run(places[0].get());
    for (std::thread &member : team) member.join();
}

}  // namespace dashpot
