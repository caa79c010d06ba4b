// A servo loop of the official C++ client library, as a peer for latency.py.
//
//   urcl_servo CONTROL_SCRIPT HOST
//
// Says "ready" once the robot's program runs. Each line of standard input, six joint angles [rad], is the
// target from then on: sent at once, and again with every state. Ends with its standard input.
//
//   c++ -std=c++17 -O2 -I$URCL/include urcl_servo.cpp -L$BUILD -lurcl -Wl,-rpath,$BUILD -pthread -o urcl_servo
//   UR_LATENCY_PEER="urcl_servo $URCL/resources/external_control.urscript" python benchmarks/latency.py

#include <atomic>
#include <chrono>
#include <iostream>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>

#include <ur_client_library/log.h>
#include <ur_client_library/ur/ur_driver.h>

int main(int argc, char* argv[])
{
  if (argc != 3)
  {
    std::cerr << "usage: urcl_servo CONTROL_SCRIPT HOST\n";
    return 2;
  }
  urcl::setLogLevel(urcl::LogLevel::ERROR);
  std::atomic<bool> running{ false };

  urcl::UrDriverConfiguration config;
  config.robot_ip = argv[2];
  config.script_file = argv[1];
  config.output_recipe = { "timestamp", "actual_q" };
  config.input_recipe = { "speed_slider_mask", "speed_slider_fraction" };
  config.headless_mode = true;
  config.handle_program_state = [&running](bool state) { running = state; };
  config.reverse_port = 50021;
  config.script_sender_port = 50022;
  config.trajectory_port = 50023;
  config.script_command_port = 50024;
  urcl::UrDriver driver(config);

  for (int tries = 0; !running && tries < 1000; ++tries)
  {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  if (!running)
  {
    std::cerr << "the control program does not connect\n";
    return 1;
  }

  std::mutex guard;
  urcl::vector6d_t target;
  bool has_target = false;
  const auto send = [&] {
    driver.writeJointCommand(target, urcl::comm::ControlMode::MODE_SERVOJ, urcl::RobotReceiveTimeout::millisec(200));
  };

  driver.startRTDECommunication();
  std::atomic<bool> over{ false };
  std::thread repeating([&] {
    urcl::rtde_interface::DataPackage state(driver.getRTDEOutputRecipe());
    while (!over)
    {
      const bool fresh = driver.getDataPackage(state);
      std::lock_guard<std::mutex> lock(guard);
      if (fresh && !has_target)
      {
        state.getData("actual_q", target);
        has_target = true;
      }
      if (has_target)
      {
        send();
      }
    }
  });

  std::cout << "ready" << std::endl;
  for (std::string line; std::getline(std::cin, line);)
  {
    std::istringstream numbers(line);
    urcl::vector6d_t wanted;
    for (double& angle : wanted)
    {
      numbers >> angle;
    }
    if (numbers)
    {
      std::lock_guard<std::mutex> lock(guard);
      target = wanted;
      has_target = true;
      send();
    }
  }
  over = true;
  repeating.join();
  driver.stopControl();
  return 0;
}
