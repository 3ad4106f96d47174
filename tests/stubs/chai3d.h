// The names of CHAI3D that examples/haptic_chai3d.cpp uses, written anew, before a simulated device: it goes 14 mm down
// from 10 mm above its origin within half a second, and stays. For tests, in one unit.
#ifndef STUB_CHAI3D_H
#define STUB_CHAI3D_H

#include <chrono>
#include <memory>
#include <thread>

namespace chai3d
{

struct cVector3d {
    explicit cVector3d(double x = 0, double y = 0, double z = 0) : m_x(x), m_y(y), m_z(z) {}
    double x() const { return m_x; }
    double y() const { return m_y; }
    double z() const { return m_z; }

  private:
    double m_x, m_y, m_z;
};

struct cMatrix3d {
    double operator()(unsigned int row, unsigned int column) const { return row == column ? 1 : 0; }
};

struct cHapticDeviceInfo {
    double m_maxLinearForce, m_maxAngularTorque, m_maxLinearStiffness, m_maxLinearDamping;
    bool m_actuatedRotation;
};

inline void cSleepMs(unsigned int milliseconds)
{
    std::this_thread::sleep_for(std::chrono::milliseconds(milliseconds));
}

struct cGenericHapticDevice {
    bool open() { return true; }
    bool close() { return true; }
    bool calibrate(bool force = false) { return !force; }
    cHapticDeviceInfo getSpecifications()
    {
        const cHapticDeviceInfo info = {10, 0, 2000, 10, false};
        return info;
    }
    bool getPosition(cVector3d &position)
    {
        const double share = m_calls < 500 ? m_calls / 500.0 : 1;
        position = cVector3d(0, 0, 0.010 - 0.014 * share);
        m_calls++;
        return true;
    }
    bool getRotation(cMatrix3d &) { return true; }
    bool getLinearVelocity(cVector3d &velocity)
    {
        velocity = cVector3d(0, 0, m_calls < 500 ? -0.028 : 0);
        return true;
    }
    bool getAngularVelocity(cVector3d &) { return true; }
    bool getUserSwitches(unsigned int &switches)
    {
        switches = 1;
        return true;
    }
    bool setForceAndTorqueAndGripperForce(const cVector3d &, const cVector3d &, double)
    {
        cSleepMs(1); // as devices' drivers do
        return true;
    }

  private:
    int m_calls = 0;
};
typedef std::shared_ptr<cGenericHapticDevice> cGenericHapticDevicePtr;

struct cHapticDeviceHandler {
    bool getDevice(cGenericHapticDevicePtr &device, unsigned int index)
    {
        device = std::make_shared<cGenericHapticDevice>();
        return index == 0;
    }
};

enum CThreadPriority { CTHREAD_PRIORITY_HAPTICS };

struct cThread {
    void start(void (*function)(void), CThreadPriority) { std::thread(function).detach(); }
};

} // namespace chai3d

#endif
