// Writes the files beside it with OpenVDB 10 (Debian: libopenvdb-dev):
//   g++ -O1 make.cpp -o make -I/usr/include/Imath -lopenvdb -ltbb -lImath-3_1 && ./make && gzip -n9 *.vdb
#include <openvdb/openvdb.h>
#include <openvdb/io/Stream.h>
#include <fstream>

using namespace openvdb;

static float value(Coord p) {
    const int h = p.x() * 7 + p.y() * 13 + p.z() * 29;
    return float(((h % 64) + 64) % 64 + 1) / 64.0f;
}

// A box of voxels across 0, inactive ones that are not 0, and active tiles of two sizes.
static FloatGrid::Ptr fog() {
    auto g = FloatGrid::create(0.0f);
    auto a = g->getAccessor();
    for (int x = -5; x < 12; ++x)
        for (int y = 3; y < 10; ++y)
            for (int z = 0; z < 21; ++z)
                if ((x + y + z) % 3 != 0) a.setValue(Coord(x, y, z), value(Coord(x, y, z)));
    // Inactive: one value; two values; background and a value; many.
    for (int x = 16; x < 24; ++x)
        for (int y = 0; y < 8; ++y)
            for (int z = 0; z < 32; ++z) {
                const Coord p(x, y, z);
                if ((x + y) % 2 == 0) { a.setValue(p, value(p)); continue; }
                if (z < 8) a.setValueOff(p, 0.25f);
                else if (z < 16) a.setValueOff(p, y < 4 ? 0.25f : 0.75f);
                else if (z < 24) a.setValueOff(p, y < 4 ? 0.0f : 0.5f);
                else a.setValueOff(p, value(p));
            }
    g->tree().addTile(1, Coord(-8, 16, 0), 0.5f, true);
    g->tree().addTile(2, Coord(128, 0, 0), 0.125f, true);
    g->setGridClass(GRID_FOG_VOLUME);
    g->setName("density");
    return g;
}

static void write(const std::string& name, const GridPtrVec& grids, uint32_t flags) {
    io::File file(name + ".vdb");
    file.setCompression(flags);
    file.write(grids);
}

int main() {
    initialize();
    const std::pair<const char*, uint32_t> kinds[] = {
        {"none", 0}, {"zip", io::COMPRESS_ZIP}, {"blosc", io::COMPRESS_BLOSC}};
    for (auto [name, flags] : kinds)
        for (bool mask : {false, true})
            for (bool half : {false, true}) {
                auto g = fog();
                g->setSaveFloatAsHalf(half);
                write(std::string(name) + (mask ? "-mask" : "") + (half ? "-half" : ""), {g},
                      flags | (mask ? io::COMPRESS_ACTIVE_MASK : 0));
            }
    {
        std::ofstream out("stream.vdb", std::ios::binary);
        auto other = FloatGrid::create(0.0f);
        other->setName("heat");
        other->tree().setValue(Coord(1, 2, 3), 4.0f);
        io::Stream(out).write(GridPtrVec{other, fog()});
    }
    {
        auto g = fog();
        auto copy = g->copy();  // shares the tree
        copy->setName("again");
        copy->setTransform(math::Transform::createLinearTransform(0.5));
        auto twin = FloatGrid::create(0.0f);
        twin->setName("density");
        twin->tree().setValue(Coord(1, 2, 3), 4.0f);
        auto v = Vec3SGrid::create(Vec3s(0)); v->setName("v"); v->tree().setValue(Coord(0, 0, 0), Vec3s(1));
        auto d = DoubleGrid::create(0); d->setName("d"); d->tree().setValue(Coord(0, 0, 0), 1.0);
        auto b = BoolGrid::create(false); b->setName("b"); b->tree().setValue(Coord(0, 0, 0), true);
        write("many", {v, d, g, b, copy, twin}, io::COMPRESS_ZIP | io::COMPRESS_ACTIVE_MASK);
    }
    {
        GridPtrVec all;
        auto add = [&](const char* name, math::MapBase::Ptr map) {
            auto g = FloatGrid::create(0.0f);
            g->tree().setValue(Coord(3, 4, 5), 1.0f);
            g->setName(name);
            g->setTransform(math::Transform::Ptr(new math::Transform(map)));
            all.push_back(g);
        };
        using namespace openvdb::math;
        add("scale", MapBase::Ptr(new ScaleMap(Vec3d(1, 2, 4))));
        add("uniform", MapBase::Ptr(new UniformScaleMap(0.5)));
        add("translate", MapBase::Ptr(new TranslationMap(Vec3d(10, 20, 30))));
        add("scale-translate", MapBase::Ptr(new ScaleTranslateMap(Vec3d(1, 2, 4), Vec3d(10, 20, 30))));
        add("uniform-translate", MapBase::Ptr(new UniformScaleTranslateMap(0.5, Vec3d(10, 20, 30))));
        add("unitary", MapBase::Ptr(new UnitaryMap(Vec3d(0, 0, 1), M_PI / 2)));
        Mat4d m(0, 2, 0, 0, -1, 0, 0, 0, 0, 0, 4, 0, 10, 20, 30, 1);
        add("affine", MapBase::Ptr(new AffineMap(m)));
        add("frustum", MapBase::Ptr(new NonlinearFrustumMap(BBoxd(Vec3d(0), Vec3d(10)), 0.5, 2.0)));
        auto odd = FloatGrid::create(0.25f);
        odd->setName("background");
        odd->tree().setValue(Coord(0, 0, 0), 1.0f);
        all.push_back(odd);
        auto minus = FloatGrid::create(0.0f);
        minus->setName("negative");
        minus->tree().setValue(Coord(-3, 5, 7), -2.0f);
        all.push_back(minus);
        auto empty = FloatGrid::create(0.0f);
        empty->setName("empty");
        all.push_back(empty);
        auto far = FloatGrid::create(0.0f);
        far->setName("far");
        far->tree().setValue(Coord(-1000000, 0, 0), 1.0f);
        far->tree().setValue(Coord(1000000, 1000000, 1000000), 1.0f);
        all.push_back(far);
        write("maps", all, io::COMPRESS_ZIP | io::COMPRESS_ACTIVE_MASK);
    }
}
