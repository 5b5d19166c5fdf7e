// iclk-NAME is the subcommand NAME.
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>

#include "apps/iclk/commands/command.h"
#include "command_fixture.h"

namespace iclk {
namespace {

using test::Finished;
using test::Folder;
using test::run;

/// A script for other programs to run; returns its path.
std::string write_script(const Folder& folder, const std::string& name, const std::string& body) {
  const std::string path = folder.write(name, "#!/bin/sh\n" + body);
  std::filesystem::permissions(path, std::filesystem::perms::owner_all);
  return path;
}

TEST(Programs, InPathAreSubcommands) {
  const Folder folder;
  const auto in_path = [&] { setenv("PATH", ("bin:" + folder.path("") + ":/usr/bin:/bin").c_str(), 1); };
  const auto say = [&](const std::vector<std::string>& line) { return run(line, in_path); };
  write_script(folder, "iclk-echo-all", "for word; do echo \"<$word>\"; done\nexit 37\n");
  write_script(folder, "iclk-killed", "kill -TERM $$\n");
  write_script(folder, "iclk-piped", "kill -PIPE $$\n");
  write_script(folder, "iclk-align", "exit 38\n");
  const Finished echoed = say({"echo-all", "--help", "a b", "", "-x"});
  EXPECT_EQ(echoed.code, 37);
  EXPECT_EQ(echoed.out, "<--help>\n<a b>\n<>\n<-x>\n");
  EXPECT_EQ(say({"killed"}).code, -SIGTERM);
  EXPECT_EQ(say({"piped"}).code, -SIGPIPE) << "it ignores nothing that we ignore";
  EXPECT_EQ(say({"align"}).code, kUsage) << "our own come first";
  EXPECT_NE(say({"--help"}).out.find("echo-all"), std::string::npos);
}

TEST(Programs, OnlyThoseOfPlainNamesAreRun) {
  const Folder folder;
  const auto in_path = [&] {
    [[maybe_unused]] const int moved = chdir(folder.path("").c_str());
    setenv("PATH", (":bin:" + folder.path("path")).c_str(), 1);
  };
  for (const char* name : {"path/iclk-Upper", "path/iclk-a.b", "path/iclk-a1", "path/iclk-", "path/iclk--x", "path/x",
                           "iclk-here", "bin/iclk-near"})
    write_script(folder, name, "echo it ran\n");
  folder.write("path/iclk-text", "#!/bin/sh\necho it ran\n");  // may not be run
  std::filesystem::create_directory(folder.path("path/iclk-folder"));
  for (const char* word : {"Upper", "a.b", "a1", "", "/../x", "../path/x", "here", "near", "text", "folder"}) {
    const Finished f = run({word}, in_path);
    EXPECT_EQ(f.code, kUsage) << word;
    EXPECT_EQ(f.out, "") << word;
    EXPECT_NE(f.err.find("subcommand"), std::string::npos) << word << f.err;
  }
  EXPECT_EQ(run({"--x"}, in_path).code, kUsage);
  const std::string help = run({"--help"}, in_path).out;
  for (const char* name : {"Upper", "a.b", "text", "near"}) EXPECT_EQ(help.find(name), std::string::npos) << help;
}

TEST(Programs, OfOneThatIsMissingItSaysWhatWasSoughtAndWhere) {
  const Folder folder;
  const std::string alone = folder.path("iclk");
  std::filesystem::copy_file(ICLK_COMMAND, alone);
  const auto say = [&](const std::vector<std::string>& line) {
    return run(line, [&] {
      setenv("PATH", "", 1);
      std::vector<char*> words = {const_cast<char*>("iclk")};
      for (const std::string& word : line) words.push_back(const_cast<char*>(word.c_str()));
      words.push_back(nullptr);
      execv(alone.c_str(), words.data());
    });
  };
  for (const std::string name : {"eval", "bench", "peers", "nothing"}) {
    const Finished f = say({name});
    EXPECT_EQ(f.code, kUsage);
    for (const std::string& piece :
         {"'" + name + "'", "iclk-" + name + " in " + std::filesystem::path(alone).parent_path().string(), std::string("PATH")})
      EXPECT_NE(f.err.find(piece), std::string::npos) << piece << ": " << f.err;
    EXPECT_EQ(f.err.find("scripts/build default iclk-" + name) != std::string::npos, name != "nothing") << f.err;
  }
  const Finished peers = say({"track", folder.path(""), "--peers"});
  EXPECT_EQ(peers.code, kUsage);
  EXPECT_NE(peers.err.find("iclk-peers"), std::string::npos) << peers.err;
  EXPECT_EQ(say({"--help"}).out.find("\n  eval"), std::string::npos);
}

TEST(Programs, BesideTheCommandAreSubcommands) {
  if (!test::has_program("iclk-eval")) GTEST_SKIP() << "no iclk-eval";
  const auto no_path = [] { unsetenv("PATH"); };
  for (const char* name : {"eval", "bench"}) {
    EXPECT_NE(run({"--help"}, no_path).out.find(std::string("\n  ") + name), std::string::npos);
    const Finished help = run({name, "--help"}, no_path);
    EXPECT_EQ(help.code, 0);
    EXPECT_NE(help.out.find(std::string("iclk ") + name + " [OPTIONS]"), std::string::npos) << help.out.substr(0, 300);
    EXPECT_EQ(run({name, "--nonsense"}, no_path).code, kUsage);
  }
}

}  // namespace
}  // namespace iclk
