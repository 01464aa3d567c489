// Messages as little-endian CDR, as ROS 2 keeps them in files: version 1 of the encoding, each number aligned to its
// size from the end of the header (OMG, DDS-XTypes 1.3, section 7.4.3).
//
// The interpreter's lock is held throughout: everything is read from Python objects.
#include "arrays.h"

#include <cmath>
#include <cstring>
#include <string>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>

#include <string_view>
#include <utility>
#include <vector>

namespace cdr {

#ifdef __BYTE_ORDER__
static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are written as they lie in memory");
#endif

// A value that its field cannot hold. The place within the message grows as the error passes the fields.
struct FieldError {
    PyObject *kind;
    std::string place, expected;
    nb::object found;
};

[[noreturn]] void refuse(PyObject *kind, std::string expected, PyObject *found) {
    throw FieldError{kind, "", std::move(expected), nb::borrow(found)};
}

// Instead of an error of Python's about a value, which does not name the field; not of one about memory or signals.
[[noreturn]] void refuse_instead(PyObject *kind, std::string expected, PyObject *found) {
    for (PyObject *about : {PyExc_TypeError, PyExc_AttributeError, PyExc_ValueError, PyExc_BufferError}) {
        if (!PyErr_ExceptionMatches(about)) continue;
        PyErr_Clear();
        refuse(kind, std::move(expected), found);
    }
    throw nb::python_error();
}

enum class Kind { boolean, signed_number, unsigned_number, float_number, text, message };

struct Number {
    const char *name;
    Kind kind;
    size_t size;
};

constexpr Number NUMBERS[] = {
    {"bool", Kind::boolean, 1},
    {"byte", Kind::signed_number, 1},  // as rosbags has it
    {"char", Kind::unsigned_number, 1},
    {"int8", Kind::signed_number, 1},
    {"uint8", Kind::unsigned_number, 1},
    {"int16", Kind::signed_number, 2},
    {"uint16", Kind::unsigned_number, 2},
    {"int32", Kind::signed_number, 4},
    {"uint32", Kind::unsigned_number, 4},
    {"int64", Kind::signed_number, 8},
    {"uint64", Kind::unsigned_number, 8},
    {"float32", Kind::float_number, 4},
    {"float64", Kind::float_number, 8},
};

// Of a field: one value, a sequence whose length is written, or else an array of a fixed length.
constexpr int64_t ONE = -1, SEQUENCE = -2;

class CdrType;

struct Field {
    nb::object name;  // interned, as getattr likes it
    Kind kind;
    size_t size;          // of a number
    const char *number;   // its name
    const CdrType *part;  // of a message
    int64_t length;       // ONE, SEQUENCE or the length of an array
};

// The fields of a message's type, in order.
class CdrType {
  public:
    CdrType(std::string name, nb::list fields) : name_(std::move(name)) {
        for (nb::handle one : fields) {
            const auto [attribute, kind, length] = nb::cast<std::tuple<nb::str, nb::object, int64_t>>(one);
            PyObject *interned = attribute.inc_ref().ptr();
            PyUnicode_InternInPlace(&interned);
            Field field{nb::steal(interned), Kind::message, 0, "", nullptr, length};
            if (nb::isinstance<CdrType>(kind)) {
                parts_.push_back(kind);
                field.part = nb::cast<const CdrType *>(kind);
            } else {
                set_base(field, nb::cast<std::string>(kind));
            }
            fields_.push_back(std::move(field));
        }
    }
    const std::string &name() const { return name_; }
    const std::vector<Field> &fields() const { return fields_; }

  private:
    void set_base(Field &field, const std::string &kind) {
        if (kind == "string") {
            field.kind = Kind::text;
            return;
        }
        for (const Number &number : NUMBERS) {
            if (kind != number.name) continue;
            field.kind = number.kind;
            field.size = number.size;
            field.number = number.name;
            return;
        }
        throw nb::value_error((name_ + ": expected a kind of number or a string, found " + kind).c_str());
    }

    std::string name_;
    std::vector<Field> fields_;
    std::vector<nb::object> parts_;  // keeps the types of fields alive
};

// The bytes object that grows as a message is written.
class Bytes {
  public:
    Bytes() : object_(PyBytes_FromStringAndSize(nullptr, FIRST_CAPACITY)) {
        if (!object_) throw nb::python_error();
        const char header[HEADER] = {0, 1, 0, 0};  // little-endian, without parameters
        std::memcpy(take(HEADER), header, HEADER);
    }
    ~Bytes() { Py_XDECREF(object_); }
    Bytes(const Bytes &) = delete;
    Bytes &operator=(const Bytes &) = delete;

    // Room for more bytes; aligned to this size, the gap is zero.
    char *take(size_t count, size_t alignment = 1) {
        const size_t gap = (HEADER - size_) & (alignment - 1);
        const size_t end = size_ + gap + count;
        if (end > capacity_) resize(end + end / 4);
        char *start = PyBytes_AS_STRING(object_) + size_;
        std::memset(start, 0, gap);
        size_ = end;
        return start + gap;
    }
    template <class T> void put(T value) { std::memcpy(take(sizeof(T), sizeof(T)), &value, sizeof(T)); }
    nb::object finished() {
        resize(size_);
        return nb::steal(std::exchange(object_, nullptr));
    }

  private:
    static constexpr size_t HEADER = 4, FIRST_CAPACITY = 1024;

    // Python's documented way to grow an object that nobody else has.
    void resize(size_t capacity) {
        if (_PyBytes_Resize(&object_, Py_ssize_t(capacity))) throw nb::python_error();
        capacity_ = capacity;
    }

    PyObject *object_;
    size_t size_ = 0, capacity_ = FIRST_CAPACITY;
};

struct Limits {
    int64_t lowest;
    uint64_t highest;
};

Limits limits_of(const Field &field) {
    const uint64_t all_bits = ~uint64_t(0) >> (64 - 8 * field.size);
    if (field.kind == Kind::unsigned_number) return {0, all_bits};
    return {-int64_t(all_bits / 2) - 1, all_bits / 2};
}

void write_whole_number(Bytes &out, const Field &field, PyObject *value) {
    nb::object index;
    if (!PyLong_Check(value)) {
        index = nb::steal(PyNumber_Index(value));
        if (!index.is_valid()) {
            refuse_instead(PyExc_TypeError, "a whole number", value);
        }
        value = index.ptr();
    }
    uint64_t bits;
    bool fits;
    if (field.kind == Kind::unsigned_number && field.size == 8) {
        bits = PyLong_AsUnsignedLongLong(value);
        fits = !PyErr_Occurred();
        PyErr_Clear();
    } else {
        int overflow = 0;
        const int64_t number = PyLong_AsLongLongAndOverflow(value, &overflow);
        const auto [lowest, highest] = limits_of(field);
        fits = !overflow && number >= lowest && (number < 0 || uint64_t(number) <= highest);
        bits = uint64_t(number);
    }
    if (!fits) {
        const auto [lowest, highest] = limits_of(field);
        const std::string range = std::to_string(lowest) + " to " + std::to_string(highest);
        refuse(PyExc_ValueError, "a number from " + range, value);
    }
    std::memcpy(out.take(field.size, field.size), &bits, field.size);
}

void write_float(Bytes &out, const Field &field, PyObject *value) {
    const double number = PyFloat_AsDouble(value);
    if (number == -1.0 && PyErr_Occurred()) refuse_instead(PyExc_TypeError, "a number", value);
    if (field.size == 8) {
        out.put(number);
        return;
    }
    const float rounded = float(number);
    if (std::isinf(rounded) && !std::isinf(number)) refuse(PyExc_ValueError, "a number that a float32 holds", value);
    out.put(rounded);
}

// Its length with the zero at its end, and both.
void write_text(Bytes &out, PyObject *value) {
    if (!PyUnicode_Check(value)) refuse(PyExc_TypeError, "a text", value);
    Py_ssize_t length = 0;
    const char *text = PyUnicode_AsUTF8AndSize(value, &length);
    if (!text) throw nb::python_error();
    out.put(uint32_t(length + 1));
    std::memcpy(out.take(size_t(length) + 1), text, size_t(length) + 1);
}

// Whether an array has a field's kind of numbers, by the letters of Python's module struct.
bool holds(const Py_buffer &view, const Field &field) {
    std::string_view format = view.format ? view.format : "B";
    const auto is_among = [&](std::string_view letters) { return letters.find(format[0]) != letters.npos; };
    if (format.size() == 2 && is_among("<=@|")) format.remove_prefix(1);
    if (view.ndim != 1 || size_t(view.itemsize) != field.size || format.size() != 1) return false;
    if (field.size == 1) return is_among("bB?c");
    return is_among(field.kind == Kind::float_number ? "fd" : field.kind == Kind::signed_number ? "hilq" : "HILQ");
}

void write_numbers(Bytes &out, const Field &field, PyObject *values) {
    const std::string expected = std::string("an array of ") + field.number;
    Py_buffer view;
    if (PyObject_GetBuffer(values, &view, PyBUF_STRIDES | PyBUF_FORMAT))
        refuse_instead(PyExc_TypeError, expected, values);
    struct Release {
        Py_buffer *view;
        ~Release() { PyBuffer_Release(view); }
    } release{&view};
    if (!holds(view, field)) refuse(PyExc_TypeError, expected, values);
    const int64_t count = view.len / view.itemsize;
    if (field.length == SEQUENCE) out.put(uint32_t(count));
    else if (count != field.length) refuse(PyExc_ValueError, std::to_string(field.length) + " values", values);
    if (!count) return;
    char *start = out.take(size_t(view.len), field.size);
    if (PyBuffer_ToContiguous(start, &view, view.len, 'C')) throw nb::python_error();
}

void write_message(Bytes &out, const CdrType &type, PyObject *message);

void write_one(Bytes &out, const Field &field, PyObject *value) {
    switch (field.kind) {
    case Kind::message: return write_message(out, *field.part, value);
    case Kind::text: return write_text(out, value);
    case Kind::float_number: return write_float(out, field, value);
    case Kind::boolean: {
        const int is_true = PyObject_IsTrue(value);
        if (is_true < 0) throw nb::python_error();
        return out.put(char(is_true));
    }
    default: return write_whole_number(out, field, value);
    }
}

void write_each(Bytes &out, const Field &field, PyObject *values) {
    const nb::object items = nb::steal(PySequence_Fast(values, ""));
    if (!items.is_valid()) refuse_instead(PyExc_TypeError, "a list", values);
    const Py_ssize_t count = PySequence_Fast_GET_SIZE(items.ptr());
    if (field.length == SEQUENCE) out.put(uint32_t(count));
    else if (count != field.length) refuse(PyExc_ValueError, std::to_string(field.length) + " values", values);
    for (Py_ssize_t i = 0; i < count; i++) {
        try {
            write_one(out, field, PySequence_Fast_GET_ITEM(items.ptr(), i));
        } catch (FieldError &error) {
            error.place = "[" + std::to_string(i) + "]" + error.place;
            throw;
        }
    }
}

void write_message(Bytes &out, const CdrType &type, PyObject *message) {
    for (const Field &field : type.fields()) {
        const nb::object value = nb::steal(PyObject_GetAttr(message, field.name.ptr()));
        if (!value.is_valid()) refuse_instead(PyExc_TypeError, "a message " + type.name(), message);
        try {
            if (field.length == ONE) write_one(out, field, value.ptr());
            else if (field.kind == Kind::text || field.kind == Kind::message) write_each(out, field, value.ptr());
            else write_numbers(out, field, value.ptr());
        } catch (FieldError &error) {
            error.place = std::string(".") + nb::cast<std::string>(field.name) + error.place;
            throw;
        }
    }
}

std::string text_of(const nb::object &value) { return nb::str(value).c_str(); }

// A number itself; of anything else its type and, where it has one, its length.
std::string told(const nb::object &found) {
    if (PyLong_Check(found.ptr()) || PyFloat_Check(found.ptr())) return text_of(found);
    const std::string type = text_of(found.type().attr("__name__"));
    if (nb::hasattr(found, "dtype"))
        return type + " of " + text_of(found.attr("dtype")) + " " + text_of(found.attr("shape"));
    return nb::hasattr(found, "__len__") ? type + " of length " + std::to_string(nb::len(found)) : type;
}

nb::object cdr(const CdrType &type, nb::object message) {
    Bytes out;
    try {
        write_message(out, type, message.ptr());
    } catch (const FieldError &error) {
        const std::string expected = type.name() + error.place + ": expected " + error.expected;
        PyErr_SetString(error.kind, (expected + ", found " + told(error.found)).c_str());
        throw nb::python_error();
    }
    return out.finished();
}

void add(nb::module_ &kernels) {
    nb::class_<CdrType>(kernels, "CdrType")
        .def(nb::init<std::string, nb::list>(), nb::arg("name"), nb::arg("fields"));
    kernels.attr("ONE") = ONE;
    kernels.attr("SEQUENCE") = SEQUENCE;
    kernels.def("cdr", &cdr, nb::arg("type"), nb::arg("message"));
}

}  // namespace cdr
