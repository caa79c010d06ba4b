// A participant of Fast DDS that hears a robot and moves it, as a node of ROS 2 would; on loopback alone.
//
// peer DOMAIN: for each line on its input, the name of a topic, it tells the next message (of latched topics the one
// that is kept); "go SECONDS Q1 ... Q6" sends a trajectory; "garbage" sends a text that claims to be a trajectory, which
// a participant can only do that has sent none. An answer with "!" says what has not happened in time.
#include <condition_variable>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include "RosPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::IPLocator;
using eprosima::fastrtps::rtps::Locator_t;

static const auto PATIENCE = std::chrono::seconds(15);
static const std::string TRAJECTORY = "rt/scaled_joint_trajectory_controller/joint_trajectory";

// Something that other threads change and this one waits for.
struct Event {
    std::mutex mutex;
    std::condition_variable changed;
    int count = 0;

    void add(int more) {
        std::lock_guard<std::mutex> lock(mutex);
        count += more;
        changed.notify_all();
    }

    bool wait(std::function<bool(int)> enough) {
        std::unique_lock<std::mutex> lock(mutex);
        return changed.wait_for(lock, PATIENCE, [&] { return enough(count); });
    }
};

class Heard : public DataReaderListener {
public:
    void on_data_available(DataReader*) override { samples.add(1); }
    void on_subscription_matched(DataReader*, const SubscriptionMatchedStatus& status) override {
        matched.add(status.current_count_change);
    }
    Event samples, matched;
};

class Listened : public DataWriterListener {
public:
    void on_publication_matched(DataWriter*, const PublicationMatchedStatus& status) override {
        matched.add(status.current_count_change);
    }
    Event matched;
};

template <typename Qos>
void reliable(Qos& qos, bool latched) {
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 10;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
}

class Peer {
public:
    explicit Peer(int domain) {
        DomainParticipantQos qos;
        auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
        udp->interfaceWhiteList.push_back("127.0.0.1");
        qos.transport().use_builtin_transports = false;
        qos.transport().user_transports.push_back(udp);
        Locator_t here;
        IPLocator::setIPv4(here, 127, 0, 0, 1);
        qos.wire_protocol().builtin.initialPeersList.push_back(here);
        participant_ = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
        if (participant_ == nullptr) throw std::runtime_error("no participant");
        subscriber_ = participant_->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
        publisher_ = participant_->create_publisher(PUBLISHER_QOS_DEFAULT);
    }

    ~Peer() {
        participant_->delete_contained_entities();
        DomainParticipantFactory::get_instance()->delete_participant(participant_);
    }

    Topic* topic(const std::string& name, TypeSupport type, const std::string& type_name = "") {
        auto& found = topics_[name];
        if (found == nullptr) {
            const std::string known_as = type_name.empty() ? type.get_type_name() : type_name;
            type.register_type(participant_, known_as);
            found = participant_->create_topic(name, known_as, TOPIC_QOS_DEFAULT);
        }
        return found;
    }

    // The next message of a topic.
    template <typename Message, typename Type>
    bool next(const std::string& name, bool latched, Message& message) {
        auto& reader = readers_[name];
        if (reader == nullptr) {
            auto qos = DATAREADER_QOS_DEFAULT;
            reliable(qos, latched);
            heard_[name] = std::make_unique<Heard>();
            reader = subscriber_->create_datareader(topic(name, TypeSupport(new Type())), qos, heard_[name].get());
        }
        SampleInfo info;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {}  // old ones
        Event& samples = heard_[name]->samples;
        int seen = latched ? 0 : samples.count;
        if (!samples.wait([&](int count) { return count > seen; })) return false;
        bool any = info.valid_data;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) any = any || info.valid_data;
        return any;
    }

    template <typename Message, typename Type>
    bool send(const std::string& name, Message& message, const std::string& type_name = "") {
        auto& writer = writers_[name];
        if (writer == nullptr) {
            auto qos = DATAWRITER_QOS_DEFAULT;
            reliable(qos, false);
            listened_[name] = std::make_unique<Listened>();
            Topic* about = topic(name, TypeSupport(new Type()), type_name);
            writer = publisher_->create_datawriter(about, qos, listened_[name].get());
        }
        if (!listened_[name]->matched.wait([](int count) { return count > 0; })) return false;
        return writer->write(&message) &&
               writer->wait_for_acknowledgments({15, 0}) == ReturnCode_t::RETCODE_OK;
    }

private:
    DomainParticipant* participant_;
    Subscriber* subscriber_;
    Publisher* publisher_;
    std::map<std::string, Topic*> topics_;
    std::map<std::string, DataReader*> readers_;
    std::map<std::string, DataWriter*> writers_;
    std::map<std::string, std::unique_ptr<Heard>> heard_;
    std::map<std::string, std::unique_ptr<Listened>> listened_;
};

static void tell(std::ostream& out, const std::vector<geometry_msgs::msg::dds_::TransformStamped_>& transforms) {
    for (const auto& t : transforms) {
        const auto& xyz = t.transform().translation();
        const auto& turn = t.transform().rotation();
        out << " " << t.header().frame_id() << ">" << t.child_frame_id() << " " << xyz.x() << " " << xyz.y() << " "
            << xyz.z() << " " << turn.x() << " " << turn.y() << " " << turn.z() << " " << turn.w();
    }
}

static bool answer(Peer& peer, const std::string& what, std::istream& rest, std::ostream& out) {
    if (what == "joint_states") {
        sensor_msgs::msg::dds_::JointState_ m;
        if (!peer.next<decltype(m), sensor_msgs::msg::dds_::JointState_PubSubType>("rt/joint_states", false, m))
            return false;
        out << " " << m.header().stamp().sec();
        for (size_t i = 0; i < m.name().size(); ++i)
            out << " " << m.name()[i] << " " << m.position()[i] << " " << m.velocity()[i] << " " << m.effort()[i];
        return true;
    }
    if (what == "tf" || what == "tf_static") {
        tf2_msgs::msg::dds_::TFMessage_ m;
        bool latched = what == "tf_static";
        if (!peer.next<decltype(m), tf2_msgs::msg::dds_::TFMessage_PubSubType>("rt/" + what, latched, m)) return false;
        tell(out, m.transforms());
        return true;
    }
    if (what == "speed_scaling") {
        std_msgs::msg::dds_::Float64_ m;
        if (!peer.next<decltype(m), std_msgs::msg::dds_::Float64_PubSubType>(
                "rt/speed_scaling_state_broadcaster/speed_scaling", false, m))
            return false;
        out << " " << m.data();
        return true;
    }
    if (what == "robot_description") {
        std_msgs::msg::dds_::String_ m;
        if (!peer.next<decltype(m), std_msgs::msg::dds_::String_PubSubType>("rt/robot_description", true, m))
            return false;
        out << " " << m.data().size();
        return true;
    }
    if (what == "go") {
        trajectory_msgs::msg::dds_::JointTrajectory_ m;
        trajectory_msgs::msg::dds_::JointTrajectoryPoint_ point;
        double seconds = 0, q = 0;
        rest >> seconds;
        while (rest >> q) point.positions().push_back(q);
        point.velocities().assign(point.positions().size(), 0.0);
        point.time_from_start().sec(static_cast<int32_t>(seconds));
        point.time_from_start().nanosec(static_cast<uint32_t>((seconds - static_cast<int32_t>(seconds)) * 1e9));
        m.joint_names({"shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
                       "wrist_3_joint"});
        m.points().push_back(point);
        return peer.send<decltype(m), trajectory_msgs::msg::dds_::JointTrajectory_PubSubType>(
            TRAJECTORY, m);
    }
    if (what == "garbage") {
        std_msgs::msg::dds_::String_ m;
        m.data("this is no trajectory");
        return peer.send<decltype(m), std_msgs::msg::dds_::String_PubSubType>(
            TRAJECTORY, m, "trajectory_msgs::msg::dds_::JointTrajectory_");
    }
    return false;
}

int main(int argc, char** argv) {
    if (argc < 2) return 2;
    Peer peer(std::stoi(argv[1]));
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::ostringstream out;
        std::string what;
        words >> what;
        out.precision(17);
        bool fine = answer(peer, what, words, out);
        std::cout << (fine ? "" : "! ") << what << out.str() << std::endl;
    }
    return 0;
}
