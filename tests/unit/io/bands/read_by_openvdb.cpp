// Reads a .nvdb file into an OpenVDB grid, prints what it is, and its values at the voxels given on stdin.
#include <openvdb/openvdb.h>
#include <nanovdb/util/IO.h>
#include <nanovdb/util/NanoToOpenVDB.h>
#include <openvdb/tools/LevelSetUtil.h>
#include <cstdio>
int main(int n, char** v) {
    openvdb::initialize();
    auto handle = nanovdb::io::readGrid(v[1]);
    auto base = nanovdb::nanoToOpenVDB(handle);
    auto grid = openvdb::gridPtrCast<openvdb::FloatGrid>(base);
    auto a = grid->getConstAccessor();
    std::printf("%zu %zu %.9g %d\n", size_t(grid->activeVoxelCount()), size_t(grid->tree().leafCount()), grid->background(), int(grid->getGridClass() == openvdb::GRID_LEVEL_SET));
    int x, y, z;
    while (std::scanf("%d %d %d", &x, &y, &z) == 3) std::printf("%.9g\n", a.getValue({x, y, z}));
    return 0;
}
